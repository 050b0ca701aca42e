"""Docstrings: a verb for a function, a noun for a class, plain words in both."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jaxgrow


PACKAGE = Path(jaxgrow.__file__).parent
LONGEST = 72
PENDING = ()
"""Folders exempt from these rules; none are."""

IMPERATIVES = """
Add Aim Allocate Apply Arrange Audit Average Bound Build Call Cast Check Choose Collapse
Compare Compose Compute Concatenate Configure Convert Copy Count Crop Cut Describe
Divide Draw Drop Enlarge Estimate Evaluate Exit Explain Extend Extract Fade Fair Fill
Filter Find Fit Flip Format Frame Gather Give Group Grow Import Interpolate Invalidate
Issue Iterate Join Keep Label Let List Load Make Map Mark Measure Merge Minimise Move
Normalise Pack Pad Place Prepare Print Project Put Raise Rasterise Read Rebuild Reduce
Refine Refuse Register Relax Relist Remove Repeat Replace Report Reset Return Rotate Run
Sample Scale Scan Search Select Separate Set Shade Shut Silence Solve Sort Split Stack
Step Store Strip Sweep Terminate Tessellate Test Trace Triangulate Unite Update Validate
Wrap Write Yield
"""
"""First words of functions, sorted; add one if none of these fits a function."""
VERBS = frozenset(IMPERATIVES.split())
RELATIVE = frozenset(("How", "What", "When", "Where", "Whether", "Which", "Who", "Why"))
BANNED = re.compile(
    r"\b(anew|by itself|come to|dear|foretold|maybe|nobody|of few|told"
    r"|(?<!there )is no(?! longer| more| less))\b",
    re.IGNORECASE,
)


class Docstring(NamedTuple):
    """A docstring of the package, and what it belongs to."""

    where: str
    node: ast.AST
    text: str
    nested: bool

    @property
    def title(self) -> str:
        return self.text.splitlines()[0]

    @property
    def first_word(self) -> str:
        return re.split(r"[\s,:;.]", self.title, maxsplit=1)[0]


@functools.cache
def docstrings() -> tuple[Docstring, ...]:
    found: list[Docstring] = []
    for file in sorted(PACKAGE.rglob("*.py")):
        place = file.relative_to(PACKAGE)
        if place.parts[0] not in PENDING:
            found += _docstrings_in(ast.parse(file.read_text("utf-8")), str(place))
    return tuple(found)


def _docstrings_in(
    node: ast.AST, where: str, nested: bool = False
) -> Iterator[Docstring]:
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    if isinstance(node, kinds) and (text := ast.get_docstring(node)):
        yield Docstring(where, node, text, nested)
    inside = nested or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    for child in ast.iter_child_nodes(node):
        name = getattr(child, "name", None)
        yield from _docstrings_in(child, f"{where}:{name}" if name else where, inside)


def _is_exempt(node: ast.FunctionDef) -> bool:
    decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
    is_property = any(name.endswith("property") for name in decorators)
    return is_property or (node.name.startswith("__") and node.name.endswith("__"))


def _functions() -> Iterator[Docstring]:
    for found in docstrings():
        node = found.node
        if isinstance(node, ast.FunctionDef) and not (found.nested or _is_exempt(node)):
            yield found


def test_a_function_begins_with_a_verb() -> None:
    wrong = [f"{d.where}: {d.title}" for d in _functions() if d.first_word not in VERBS]
    assert not wrong, "\n".join(wrong)


def test_the_verbs_are_sorted_and_each_is_there_once() -> None:
    assert IMPERATIVES.split() == sorted(VERBS)


def test_a_class_begins_with_a_noun() -> None:
    classes = [d for d in docstrings() if isinstance(d.node, ast.ClassDef)]
    wrong = [
        f"{d.where}: {d.title}" for d in classes if d.first_word in VERBS | RELATIVE
    ]
    assert not wrong, "\n".join(wrong)


def test_a_module_has_no_relative_clause_as_a_title() -> None:
    modules = [d for d in docstrings() if isinstance(d.node, ast.Module)]
    wrong = [f"{d.where}: {d.title}" for d in modules if d.first_word in RELATIVE]
    assert not wrong, "\n".join(wrong)


def test_a_first_line_is_short_and_ends_with_a_full_stop() -> None:
    wrong = [
        f"{d.where}: {d.title}"
        for d in docstrings()
        if len(d.title) > LONGEST or not d.title.endswith(".")
    ]
    assert not wrong, "\n".join(wrong)


def test_no_docstring_has_a_banned_word() -> None:
    wrong = []
    for found in docstrings():
        # names are code: between backticks, or of an argument
        words = re.sub(r"`[^`]*`|^\s+\w+:", "", found.text, flags=re.MULTILINE)
        words = " ".join(words.split())
        wrong += [f"{found.where}: {match[0]}" for match in BANNED.finditer(words)]
    assert not wrong, "\n".join(wrong)
