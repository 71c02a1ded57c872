"""Expressions of parameters, such as `0.5 * distance + 1`: parsed once, bounded, and evaluated without running any code."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import InputError

__all__ = ["FUNCTIONS", "Expression"]

_LONGEST = 400
_CONSTANTS = {"pi": math.pi, "e": math.e}
#: What an expression may call.
FUNCTIONS: dict[str, Callable[..., float]] = {
    "sqrt": math.sqrt, "exp": math.exp, "log": math.log, "log10": math.log10, "sin": math.sin, "cos": math.cos,
    "tan": math.tan, "atan2": math.atan2, "radians": math.radians, "degrees": math.degrees, "abs": abs, "min": min,
    "max": max, "floor": math.floor, "ceil": math.ceil, "round": round,
}  # fmt: skip
_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Mod: lambda a, b: a % b,
    ast.Pow: math.pow,
}
_COMPARED: dict[type[ast.cmpop], Callable[[float, float], bool]] = {
    ast.Lt: lambda a, b: a < b,
    ast.LtE: lambda a, b: a <= b,
    ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b,
}


class Expression:
    """A number as an expression of other parameters.

    Main arguments:
        text: numbers, names, + - * / % **, `a if x < y else b`, the constants pi and e, and `FUNCTIONS`.
        where: the key that holds it, for messages.

    `names` are the parameters that it needs. Raises InputError: not well formed, or anything else in it.
    """

    def __init__(self, text: str, where: str) -> None:
        self.text, self.where = text, where
        if len(text) > _LONGEST:
            raise self._refused("An expression is too long.", f"{len(text)} characters", f"at most {_LONGEST}")
        try:
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise self._refused("An expression is not well formed.", text, str(error)) from error
        self.names: frozenset[str] = frozenset(self._names(self._tree))

    def at(self, values: Mapping[str, Any]) -> float:
        """Its value. Raises InputError where a parameter is no number, and where the result is not finite."""
        try:
            found = float(self._value(self._tree, values))
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self._refused("An expression has no value.", self._told(values), str(error)) from error
        if not math.isfinite(found):
            raise self._refused("The value of an expression is not finite.", self._told(values), "a finite number")
        return found

    def _told(self, values: Mapping[str, Any]) -> str:
        return f"{self.text} at " + ", ".join(f"{name} = {values.get(name)!r}" for name in sorted(self.names))

    def _names(self, node: ast.AST) -> list[str]:
        """Names of parameters below a node. Raises InputError for what an expression may not hold."""
        match node:
            case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
                return []
            case ast.Name(id=name):
                return [] if name in _CONSTANTS else [name]
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=inner):
                return self._names(inner)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
                return self._names(left) + self._names(right)
            case ast.IfExp(test=ast.Compare(left=left, ops=[op], comparators=[right]), body=body, orelse=other) if (
                type(op) in _COMPARED
            ):
                return [name for one in (left, right, body, other) for name in self._names(one)]
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS and args:
                return [found for one in args for found in self._names(one)]
        raise self._refused(
            "An expression holds what it may not.", ast.unparse(node)[:80],
            "numbers, parameters, + - * / % **, `a if x < y else b`, pi, e, " + ", ".join(FUNCTIONS),
        )  # fmt: skip

    def _value(self, node: ast.AST, values: Mapping[str, Any]) -> Any:
        match node:
            case ast.Constant(value=value):
                return float(value)  # type: ignore[arg-type]
            case ast.Name(id=name):
                return _CONSTANTS[name] if name in _CONSTANTS else _number(name, values[name])
            case ast.UnaryOp(op=op, operand=inner):
                found = self._value(inner, values)
                return -found if isinstance(op, ast.USub) else found
            case ast.BinOp(left=left, op=op, right=right):
                return _BINARY[type(op)](self._value(left, values), self._value(right, values))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return _COMPARED[type(op)](self._value(left, values), self._value(right, values))
            case ast.IfExp(test=test, body=body, orelse=other):
                return self._value(body if self._value(test, values) else other, values)
            case ast.Call(func=ast.Name(id=name), args=args):
                return FUNCTIONS[name](*(self._value(one, values) for one in args))
        raise TypeError(ast.dump(node))

    def _refused(self, what: str, value: object, allowed: str) -> InputError:
        return InputError(what, where=self.where, value=value, allowed=allowed)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{name} is {value!r}, no number")
    return float(value)
