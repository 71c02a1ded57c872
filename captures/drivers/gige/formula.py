"""Formulas of a camera's description (converters, Swiss knives), read by a parser of our own: no code of a camera is ever run."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping

__all__ = ["FormulaError", "evaluate"]

_TOKEN = re.compile(
    r"\s*(0x[0-9A-Fa-f]+|\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+|\*\*|<<|>>|<=|>=|<>|&&|\|\||[A-Za-z_]\w*|[-+*/%()<>=&|^~?:])"
)
#: Binary operators from those that bind least; all but "**" from the left.
_LEVELS: tuple[dict[str, Callable[[float, float], float]], ...] = (
    {"||": lambda a, b: float(bool(a) or bool(b))},
    {"&&": lambda a, b: float(bool(a) and bool(b))},
    {"|": lambda a, b: int(a) | int(b)},
    {"^": lambda a, b: int(a) ^ int(b)},
    {"&": lambda a, b: int(a) & int(b)},
    {"=": lambda a, b: float(a == b), "<>": lambda a, b: float(a != b)},
    {"<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge},
    {"<<": lambda a, b: int(a) << _bits(b), ">>": lambda a, b: int(a) >> _bits(b)},
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul, "/": operator.truediv, "%": operator.mod},
)
_LONGEST, _DEEPEST = 2000, 40


class FormulaError(ValueError):
    """A formula that is not read, or has no value."""


def _bits(count: float) -> int:
    if not 0 <= count <= 64:
        raise FormulaError("a shift by more than 64 bits")
    return int(count)


def evaluate(text: str, values: Mapping[str, float]) -> float:
    """Value of a formula with + - * / % **, comparisons, bits, a ? b : c, and the names of `values`.

    Raises:
        FormulaError: anything else, division by zero, a number that overflows.
    """
    if len(text) > _LONGEST:
        raise FormulaError("a formula that is too long")
    tokens, at = [], 0
    stripped = text.strip()
    while at < len(stripped):
        found = _TOKEN.match(stripped, at)
        if found is None:
            raise FormulaError(f"not a formula at {stripped[at : at + 10]!r}")
        tokens.append(found[1])
        at = found.end()
    reader = _Reader(tokens, values)
    try:
        value = float(reader.choice(0))
    except (ArithmeticError, ValueError) as error:
        raise FormulaError(str(error)) from error
    if reader.tokens:
        raise FormulaError(f"{reader.tokens[0]!r} is left over")
    return value


class _Reader:
    def __init__(self, tokens: list[str], values: Mapping[str, float]) -> None:
        self.tokens, self._values = tokens, values

    def choice(self, depth: int) -> float:
        if depth > _DEEPEST:
            raise FormulaError("a formula that is nested too deeply")
        condition = self._binary(0, depth)
        if not self._take("?"):
            return condition
        first = self.choice(depth + 1)
        self._need(":")
        second = self.choice(depth + 1)
        return first if condition else second

    def _binary(self, level: int, depth: int) -> float:
        if level == len(_LEVELS):
            return self._sign(depth)
        value = self._binary(level + 1, depth)
        while self.tokens and self.tokens[0] in _LEVELS[level]:
            value = _LEVELS[level][self.tokens.pop(0)](value, self._binary(level + 1, depth))
        return value

    def _sign(self, depth: int) -> float:
        if depth > _DEEPEST:
            raise FormulaError("a formula that is nested too deeply")
        for sign, apply in (("-", operator.neg), ("+", operator.pos), ("~", lambda a: ~int(a))):
            if self._take(sign):
                return float(apply(self._sign(depth + 1)))
        value = self._atom(depth)
        if self._take("**"):
            power = self._sign(depth + 1)
            if abs(power) > 64:
                raise FormulaError("a power beyond 64")
            raised = value**power
            if isinstance(raised, complex):
                raise FormulaError("a root of a negative number")
            return float(raised)
        return value

    def _atom(self, depth: int) -> float:
        if not self.tokens:
            raise FormulaError("a formula that breaks off")
        token = self.tokens.pop(0)
        if token == "(":
            value = self.choice(depth + 1)
            self._need(")")
            return value
        if token in self._values:
            return self._values[token]
        if token.startswith("0x"):
            return float(int(token, 16))
        if token[0].isdigit() or token[0] == ".":
            return float(token)
        raise FormulaError(f"{token!r} is no number and no name")

    def _take(self, token: str) -> bool:
        if self.tokens[:1] == [token]:
            self.tokens.pop(0)
            return True
        return False

    def _need(self, token: str) -> None:
        if not self._take(token):
            raise FormulaError(f"{token!r} is missing")
