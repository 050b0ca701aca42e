"""Code generation: traced JAX functions of scalars, printed as source.

The source is that of compiled loops. An energy is written once, as a JAX function of
the scalars of one element. Its derivatives are taken by JAX; the result is
straight-line scalar code (a jaxpr of some dozens of primitives), which is printed here
statement by statement. Equal expressions are printed once, and unused ones are omitted.

A minimum or maximum returns the second operand where the first is NaN.
"""

import ast
import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal


class UnprintableError(ValueError):
    """Error: a primitive that the printer does not support."""


_INFIX = {
    "add": "+",
    "add_any": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "pow": "**",
    "lt": "<",
    "gt": ">",
    "le": "<=",
    "ge": ">=",
    "eq": "==",
    "ne": "!=",
    "and": "&",
    "or": "|",
    "xor": "^",
}

_COMMUTATIVE = {"add", "add_any", "mul", "and", "or", "eq", "ne"}

_TEMPLATES = {
    "max": "{0} if {0} > {1} else {1}",
    "min": "{0} if {0} < {1} else {1}",
    "neg": "-{0}",
    "square": "{0} * {0}",
    "not": "not {0}",
    "abs": "abs({0})",
    "sign": "1.0 if {0} > 0.0 else (-1.0 if {0} < 0.0 else 0.0)",
    "rsqrt": "1.0 / math.sqrt({0})",
    "logistic": "1.0 / (1.0 + math.exp(-{0}))",
    "is_finite": "math.isfinite({0})",
    "atan2": "math.atan2({0}, {1})",
    **{
        name: f"math.{function}({{0}})"
        for name, function in {
            **{n: n for n in ("sqrt", "exp", "log", "sin", "cos", "tan", "floor")},
            **{n: n for n in ("sinh", "cosh", "tanh", "asin", "acos", "atan")},
            **{n: n for n in ("log1p", "expm1", "erf", "ceil")},
        }.items()
    },
}

_UNCHANGED = {
    "broadcast_in_dim",
    "copy",
    "copy_p",
    "optimization_barrier",
    "reshape",
    "squeeze",
    "stop_gradient",
}
"""Primitives that return their operands; their effect is void for scalars."""

_NAME = re.compile(r"\bt\d+\b")


def print_function(
    name: str, function: Callable[..., Sequence[Any]], arguments: Sequence[str]
) -> str:
    """Print the source of a function from numbers to a tuple of numbers.

    Args:
        name: of the printed function.
        function: takes a scalar for each argument, returns a sequence of scalars.
        arguments: their names.

    Raises:
        UnprintableError: it uses other operations than arithmetic of scalars.
    """
    closed = jax.make_jaxpr(lambda *a: tuple(function(*a)))(
        *[jnp.zeros((), jnp.float64) for _ in arguments]
    )
    printer = _Printer(arguments)
    results = printer.walk(closed, list(arguments))
    body = _needed(printer.lines, results)
    lines = [f"    {target} = {expression}" for target, expression in body]
    returned = "".join(f"{result}, " for result in results).strip()
    head = f"def {name}({', '.join(arguments)}):"
    return "\n".join([head, *lines, f"    return ({returned})", ""])


def _needed(
    lines: list[tuple[str, str]], results: Sequence[str]
) -> list[tuple[str, str]]:
    """Select the statements that a result depends on, in their order."""
    needed = {name for result in results for name in _NAME.findall(result)}
    kept = []
    for target, expression in reversed(lines):
        if target in needed:
            kept.append((target, expression))
            needed.update(_NAME.findall(expression))
    return kept[::-1]


def _literal(value: Any) -> str:
    number = np.asarray(value)
    if number.ndim:
        raise UnprintableError(f"an array of shape {number.shape}")
    plain = number.item()
    if isinstance(plain, float) and not math.isfinite(plain):
        return {math.inf: "math.inf", -math.inf: "(-math.inf)"}.get(plain, "math.nan")
    text = repr(plain)
    return f"({text})" if text.startswith("-") else text


class _Printer:
    """Printer of statements, each expression once."""

    def __init__(self, arguments: Sequence[str]) -> None:
        self.lines: list[tuple[str, str]] = []
        self._arguments = set(arguments)
        self._known: dict[str, str] = {}

    def assign(self, expression: str) -> str:
        """Return the name of an expression's value, and print it if it is new."""
        if expression not in self._known:
            name = f"t{len(self.lines)}"
            self.lines.append((name, expression))
            self._known[expression] = name
        return self._known[expression]

    def walk(self, closed: ClosedJaxpr, arguments: list[str]) -> list[str]:
        """Print a function's statements, and return the names of its results."""
        return self._walk(closed.jaxpr, list(closed.consts), arguments)

    def _walk(
        self, jaxpr: Jaxpr, constants: list[Any], arguments: list[str]
    ) -> list[str]:
        names: dict[Any, str] = {}

        def read(atom: Any) -> str:
            if isinstance(atom, Literal):
                kind: Any = atom.aval
                return _literal(np.asarray(atom.val, kind.dtype))
            return names[atom]

        for variable, constant in zip(jaxpr.constvars, constants, strict=True):
            names[variable] = _literal(constant)
        names.update(zip(jaxpr.invars, arguments, strict=True))
        for equation in jaxpr.eqns:
            for variable in equation.outvars:
                shape = getattr(variable.aval, "shape", ())
                if shape != ():
                    raise UnprintableError(f"{equation.primitive} of shape {shape}")
            operands = [read(atom) for atom in equation.invars]
            results = self._equation(equation, operands)
            names.update(zip(equation.outvars, results, strict=True))
        return [read(variable) for variable in jaxpr.outvars]

    def _equation(self, equation: Any, operands: list[str]) -> list[str]:
        name, given = equation.primitive.name, equation.params
        inner = given.get("jaxpr", given.get("call_jaxpr"))
        if inner is not None:
            closed = isinstance(inner, ClosedJaxpr)
            constants = list(inner.consts) if closed else []
            return self._walk(inner.jaxpr if closed else inner, constants, operands)
        if name in _UNCHANGED:
            return operands
        if name == "convert_element_type":
            return [self._converted(equation, operands[0])]
        if name in ("mul", "add", "add_any") and (short := _shortened(name, *operands)):
            return [short]
        if name in _INFIX:
            if name in _COMMUTATIVE:
                operands = sorted(operands)
            return [self.assign(f"{operands[0]} {_INFIX[name]} {operands[1]}")]
        if name == "select_n" and len(operands) == 3:
            off, on = operands[1:]
            if on == off:
                return [on]
            return [self.assign(f"{on} if {operands[0]} else {off}")]
        if name == "integer_pow":
            return [self._power(operands[0], given["y"])]
        if name == "clamp":
            low, value, high = operands
            above = self.assign(_TEMPLATES["max"].format(value, low))
            return [self.assign(_TEMPLATES["min"].format(above, high))]
        if name in _TEMPLATES:
            return [self.assign(_TEMPLATES[name].format(*operands))]
        raise UnprintableError(name)

    def _converted(self, equation: Any, operand: str) -> str:
        before = equation.invars[0].aval.dtype
        after = np.dtype(equation.params["new_dtype"])
        if before == after or after == np.bool_:
            return operand
        if not _NAME.fullmatch(operand) and operand not in self._arguments:
            return _literal(np.asarray(ast.literal_eval(operand), after))
        if np.issubdtype(after, np.floating):
            if before == np.bool_:
                return self.assign(f"1.0 if {operand} else 0.0")
            if np.issubdtype(before, np.integer):
                return self.assign(f"float({operand})")
            return operand
        return self.assign(f"int({operand})")

    def _power(self, base: str, exponent: int) -> str:
        """Print an integer power by products; a negative one by the inverse."""
        left, square, result = abs(exponent), base, None
        while left:
            if left & 1:
                result = square if result is None else f"{result} * {square}"
                result = self.assign(result) if " " in result else result
            left >>= 1
            if left:
                square = self.assign(f"{square} * {square}")
        if result is None:
            return "1.0"
        return result if exponent > 0 else self.assign(f"1.0 / {result}")


def _shortened(name: str, one: str, other: str) -> str | None:
    """Return the operand of a product with 1 or a sum with 0; else None."""
    neutral = "1.0" if name == "mul" else "0.0"
    if one == neutral:
        return other
    if other == neutral:
        return one
    return None
