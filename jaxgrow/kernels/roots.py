"""Roots: compiled loops of energy terms, printed from their energies.

A *root* is the compiled function of one term that is called at every evaluation: it
adds the term's forces, or its Hessian product with a displacement. Another function of
it is called once for each linear solve, as a preconditioner: it adds the approximate
diagonal blocks of the Hessian, 3 × 3 for each node. The source is printed into a file
of the cache folder, and compiled there by numba, which caches the code beside it. A
root is called by its address, so that it is never optimised together with a caller: its
bits depend on its source alone.

The argument of a root is the address of a table of integers: for each of its buffers
the address and two lengths, then the numbers and addresses of `jaxgrow.kernels.tables`.
"""

import contextlib
import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from jaxgrow.kernels.arguments import Argument
from jaxgrow.kernels.printer import print_function
from jaxgrow.runtime.compile_cache import may_be_written, private_folder


@dataclass(frozen=True)
class Buffer:
    """Array that a root reads.

    Attributes:
        name: in the root's statements.
        kind: of its entries: "reals", "flags", "short" or "long" integers.
        rank: 1 or 2.
    """

    name: str
    kind: str
    rank: int = 1

    @property
    def argument(self) -> Argument:
        """Declaration of the array as an argument."""
        return Argument(self.name, _DTYPES[self.kind], self.rank)


@dataclass(frozen=True)
class Printed:
    """Function of numbers that is printed.

    Attributes:
        name: in the root's statements.
        function: of scalars; returns a sequence of scalars.
        arguments: their names.
    """

    name: str
    function: Callable[..., Sequence[Any]]
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Root:
    """Definition of a loop that is printed.

    Attributes:
        name: of its file.
        functions: that are printed from JAX functions.
        loops: source of further functions, which call those.
        buffers: that it reads.
        statements: its body. Its variables are the buffers by name, `nodes` (particles,
            then vertices, then static ones), the number `count` of particles, the
            displacement `along`, `out`, to which it adds, and the distances `clear`,
            which it lowers.
        blocks: statements that add diagonal blocks to the rows of `out`, likewise; none
            for a root of forces.
    """

    name: str
    functions: tuple[Printed, ...]
    loops: str
    buffers: tuple[Buffer, ...]
    statements: tuple[str, ...]
    blocks: tuple[str, ...] = ()


_READERS = {
    "reals": "reals",
    "flags": "booleans",
    "short": "indices",
    "long": "long_indices",
}

_DTYPES = {
    "reals": np.float64,
    "flags": np.bool_,
    "short": np.int32,
    "long": np.int64,
}

_HEAD = '''"""Printed by jaxgrow from the energy of one element; changes are lost."""

import math

import numpy as np
from numba import cfunc, njit, types

from jaxgrow.kernels import collision, contact, pair, vicinity
from jaxgrow.kernels.frames import booleans, indices, long_indices, reals
from jaxgrow.kernels.regrouped import regrouped

'''


def source_of(root: Root) -> str:
    """Print the source of a root's module.

    Raises:
        UnprintableError: a function uses an operation that the printer does not
            support.
    """
    printed = (print_function(f.name, f.function, f.arguments) for f in root.functions)
    return "\n".join(
        [
            _HEAD,
            *(f"\n@regrouped\n{text}\n" for text in printed),
            root.loops,
            _main("root", root.buffers, root.statements, columns=3),
            *(
                [_main("blocks", root.buffers, root.blocks, columns=9)]
                * bool(root.blocks)
            ),
        ]
    )


def _main(
    name: str, buffers: Sequence[Buffer], statements: Sequence[str], columns: int
) -> str:
    """Print the function that is called with a table.

    Args:
        name: of the function.
        buffers: that it reads.
        statements: its body.
        columns: number of columns of `out`.
    """
    lines = ["", "@cfunc(types.void(types.intp), cache=True)", f"def {name}(table_at):"]
    words = 3 * len(buffers)
    lines += [f"    table = long_indices(table_at, ({words + 6},))"]
    for number, buffer in enumerate(buffers):
        at = 3 * number
        shape = ", ".join(f"table[{at + 1 + axis}]" for axis in range(buffer.rank))
        reader = _READERS[buffer.kind]
        lines.append(f"    {buffer.name} = {reader}(table[{at}], ({shape},))")
    lines += [
        f"    total, count = table[{words}], table[{words + 1}]",
        f"    nodes = reals(table[{words + 2}], (total, 3))",
        f"    along = reals(table[{words + 3}], (total, 3))",
        f"    out = reals(table[{words + 4}], (total, {columns}))",
        f"    clear = reals(table[{words + 5}], (total,))",
        *(f"    {statement}" for statement in statements),
        "",
    ]
    return "\n".join(lines)


@functools.cache
def cache_folder() -> Path:
    """Find the folder of printed loops; if none is writable, a temporary one."""
    choice = os.environ.get("JAXGROW_LOOPS_CACHE")
    with contextlib.suppress(OSError, RuntimeError):
        folder = Path(choice) if choice else Path.home() / ".cache/jaxgrow/loops"
        if may_be_written(folder):
            folder.mkdir(parents=True, exist_ok=True)
            return folder
    folder = private_folder("printed")
    if folder is None:
        _temporary.append(tempfile.TemporaryDirectory(prefix="jaxgrow-"))
        folder = Path(_temporary[-1].name)
    return folder


_temporary: list[tempfile.TemporaryDirectory[str]] = []
"""Temporary folders, kept as long as the process."""


@functools.cache
def _digest_of_loops() -> str:
    """Compute the digest of the sources of all loops.

    Roots use some of them only; with all of them none can be omitted.
    """
    return _digest(sorted(Path(__file__).parent.glob("*.py")))


@functools.cache
def _digest_of_energies() -> str:
    """Compute the digest of the sources that printed functions depend on.

    These are the functions of this package. The version of JAX is appended.
    """
    from jax import __version__

    package = Path(__file__).parent.parent
    own = (package / name for name in ("numerics/guards.py", "equilibrium/roots.py"))
    printing = (package / f"kernels/{name}.py" for name in ("printer", "roots"))
    energies = sorted((package / "energy").glob("*.py"))
    return _digest([*own, *printing, *energies]) + __version__


def _digest(paths: Iterable[Path]) -> str:
    content = hashlib.sha256()
    for path in paths:
        content.update(path.name.encode() + b"\0" + path.read_bytes())
    return content.hexdigest()[:16]


def load(name: str, make: Callable[[], Root], *, of_package: bool) -> ModuleType:
    """Load the compiled module of a root; print it if it is not in the cache.

    Its file is named by the digests of the printed source and of the loops that it
    calls. For a root of this package, a key file, named by the digest of the sources
    that it is printed from, holds this name, so that it is found without being traced.

    Args:
        name: of the root.
        make: makes the root.
        of_package: whether it depends on the sources of this package alone.

    Raises:
        UnprintableError: a function uses an operation that the printer does not
            support.
    """
    folder = cache_folder()
    note = folder / f"{name}_{_short(name + _digest_of_energies())}.key"
    if of_package and note.exists():
        module = note.read_text(encoding="utf-8")
        if _digest_of_loops() in module and (folder / module).exists():
            return _imported(folder / module)
    source = source_of(make())
    digest = _short(source)
    path = folder / f"jaxgrow_{name}_{digest}_{_digest_of_loops()}.py"
    if not path.exists():
        _write(path, source)
    if of_package:
        _write(note, path.name)
    return _imported(path)


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _imported(path: Path) -> ModuleType:
    """Import the module of a file, once per process.

    If numba's cached code cannot be read, it is deleted and compiled again.
    """
    if path.stem not in sys.modules:
        try:
            return _executed(path)
        # numba's reader raises many errors for a truncated file
        except Exception:
            for kept in _kept_of(path):
                kept.unlink(missing_ok=True)
            return _executed(path)
    return sys.modules[path.stem]


def _executed(path: Path) -> ModuleType:
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    # numba looks up the module by its name, and cannot read the cached code of a module
    # that it does not find
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[path.stem]
        raise
    return module


def _kept_of(path: Path) -> list[Path]:
    """List numba's cached files of a printed module."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    return [
        kept
        for folder in (path.parent, *([Path(named)] if named else []))
        for kept in folder.rglob(f"{path.stem}.*.nb?")
    ]


def _write(path: Path, text: str) -> None:
    """Write a file atomically: whole or not at all."""
    with tempfile.NamedTemporaryFile(
        "w", dir=path.parent, suffix=".part", delete=False, encoding="utf-8"
    ) as file:
        file.write(text)
    Path(file.name).replace(path)
