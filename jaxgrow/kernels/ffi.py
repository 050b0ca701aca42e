"""Handlers of XLA's foreign function interface, compiled by numba.

An XLA program calls a handler without the Python interpreter and with its own buffers.
A handler is not a host callback: it runs on any thread, and the program remains
cacheable on disk. Its argument is a *call frame*; its layout (version 0.x of
``xla/ffi/api/c_api.h``, 64 bits) is in `jaxgrow.kernels.frames`. Another major version
is refused by XLA when a handler is registered, and `refused` returns the reason.
"""

import ctypes
import functools
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import version
from typing import Any

import jax

from jaxgrow.kernels import refusal
from jaxgrow.kernels.arguments import Argument, checked, checked_shapes
from jaxgrow.kernels.refusals import Refusal, said
from jaxgrow.runtime.slow_path import UnvalidatedVersionWarning, warn_once


NEWEST_VALIDATED_JAXLIB = "0.10.1"
"""The newest version of jaxlib with which all tests of the loops have passed."""

_new_capsule = ctypes.PYFUNCTYPE(
    ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p
)(("PyCapsule_New", ctypes.pythonapi))


def target(name: str) -> str:
    """Return the name by which a handler is registered with XLA."""
    return f"jaxgrow_{name}"


@functools.cache
def refused(name: str) -> Refusal | None:
    """Register a handler with XLA; return the reason if that fails, else None.

    Args:
        name: of a module of `jaxgrow.kernels` with a handler.
    """
    found = refusal()
    if found is not None:
        return found
    try:
        # not at the top: numba takes half a second to import
        handler: Any = import_module(f"jaxgrow.kernels.{name}").handler
    # numba and LLVM raise many errors, and XLA computes the same
    except Exception as error:
        folder = import_module("jaxgrow.kernels.loop_cache").kept_in()
        return Refusal(
            f"numba cannot compile or load one of them ({said(error)})",
            f"delete the files in {folder}, and if that does not help, install the "
            "version of numba in constraints.txt",
        )
    try:
        capsule = _new_capsule(handler.address, None, None)
        jax.ffi.register_ffi_target(target(name), capsule, platform="cpu")
    # XLA refuses handlers for another version by its own class of error
    except Exception as error:
        return Refusal(
            f"jaxlib {_jaxlib()} does not take them ({said(error)})",
            f"install jaxlib {NEWEST_VALIDATED_JAXLIB}",
        )
    return None


def registered(name: str) -> bool:
    """Return whether XLA can call a handler; the first call registers it.

    Args:
        name: of a module of `jaxgrow.kernels` with a handler.

    Warns:
        SlowPathWarning: it cannot, and the user did not disable loops.
        UnvalidatedVersionWarning: it can, with a jaxlib newer than those tested.
    """
    found = refused(name)
    if found is None:
        warn_if_unvalidated(_jaxlib())
    else:
        found.say()
    return found is None


@functools.cache
def warn_if_unvalidated(jaxlib: str) -> None:
    """Issue a warning, once, if jaxlib is newer than the versions tested.

    Args:
        jaxlib: the version.
    """
    if _numbers(jaxlib) > _numbers(NEWEST_VALIDATED_JAXLIB):
        warn_once(
            f"jaxlib is {jaxlib}, and compiled loops, which rely on the layout of its "
            f"calls, are tested up to {NEWEST_VALIDATED_JAXLIB} only; set "
            "JAXGROW_KERNELS=off to be safe (growths take up to four times longer).",
            UnvalidatedVersionWarning,
        )


@functools.cache
def _jaxlib() -> str:
    """Read the version of jaxlib; this takes longer than a small descent."""
    return version("jaxlib")


def _numbers(release: str) -> list[int]:
    """Extract the leading numbers of a version."""
    found = re.match(r"\d+(\.\d+)*", release)
    return [] if found is None else [int(part) for part in found[0].split(".")]


def call(
    name: str,
    arguments: Sequence[Argument],
    results: Sequence[Argument],
    values: Mapping[str, Any] | Sequence[Any],
    result_shapes: Mapping[str, Sequence[int]] | Sequence[Sequence[int]],
    aliases: Mapping[str, str] | None = None,
    **options: Any,
) -> tuple[jax.Array, ...]:
    """Call a registered handler within an XLA program.

    Args:
        name: of the module of `jaxgrow.kernels`.
        arguments: that the handler declares.
        results: likewise.
        values: of the arguments, by name or in that order.
        result_shapes: of the results, likewise.
        aliases: names of arguments, each with the name of the result that has its
            initial value and may share its memory.
        **options: of `jax.ffi.ffi_call`.

    Returns:
        The results, in the order declared.

    Raises:
        TypeError: a value or a shape is not as declared; the message names it.
    """
    given = checked(name, arguments, values)
    shapes = checked_shapes(name, results, result_shapes)
    places = {
        [one.name for one in arguments].index(before): [
            one.name for one in results
        ].index(after)
        for before, after in (aliases or {}).items()
    }
    for before, after in places.items():
        was = tuple(given[before].shape), arguments[before].dtype
        if was != (shapes[after], results[after].dtype):
            raise TypeError(
                f"result {results[after].name!r} of the loop {name!r} is to begin as "
                f"argument {arguments[before].name!r}, but has another shape or type."
            )
    return tuple(
        jax.ffi.ffi_call(
            target(name),
            [
                jax.ShapeDtypeStruct(shape, declared.dtype)
                for shape, declared in zip(shapes, results, strict=True)
            ],
            input_output_aliases=places,
            **options,
        )(*given)
    )
