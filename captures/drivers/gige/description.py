"""A camera's own description of its features (GenICam XML), and their values in its registers.

Read: Integer, IntReg, MaskedIntReg, IntSwissKnife, IntConverter, Float, FloatReg, SwissKnife, Converter, Boolean, Enumeration,
Command, StringReg. Source: EMVA, GenICam standard, part 1 (GenApi), 2.1. A description is data from a stranger: its size, the
depth of its references and its formulas are bounded, and a document type (which could grow without bound) is refused.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Literal, Protocol
from xml.etree import ElementTree

from .formula import FormulaError, evaluate

__all__ = ["Features", "Memory", "NoFeature"]

_LARGEST = 16 * 2**20
_DEEPEST = 24
_MOST_NODES = 50_000


class NoFeature(ValueError):
    """The camera has no such feature, or describes it in a way that is not read."""


class Memory(Protocol):
    """Registers of a camera, as bytes."""

    def read_memory(self, address: int, size: int) -> bytes:
        """`size` bytes from `address` on."""
        ...

    def write_memory(self, address: int, data: bytes) -> None:
        """Write bytes."""
        ...


class Features:
    """The features that the description `xml` names, in the registers of `memory`. Raises NoFeature for what is no description."""

    def __init__(self, xml: bytes, memory: Memory) -> None:
        if len(xml) > _LARGEST or b"<!DOCTYPE" in xml or b"<!ENTITY" in xml:
            raise NoFeature("the description is too large, or has a document type")
        try:
            root = ElementTree.fromstring(xml.strip(b"\0 \r\n\t"))
        except (ElementTree.ParseError, ValueError, LookupError) as error:
            raise NoFeature(f"the description is not well formed: {error}") from error
        self._memory = memory
        self._nodes: dict[str, _Node] = {}
        for element in root.iter():
            name = element.get("Name")
            if name and _tag(element) != "EnumEntry":
                self._nodes.setdefault(name, _Node(element))
            if len(self._nodes) > _MOST_NODES:
                raise NoFeature("the description has too many features")

    def __contains__(self, name: object) -> bool:
        return name in self._nodes

    def get(self, name: str) -> int | float | str | bool:
        """Value of a feature: a number, a flag, a text, or the name of the entry of an enumeration. Raises NoFeature."""
        node = self._node(name)
        if node.kind == "StringReg":
            raw = self._memory.read_memory(self._address(node, 0), node.size())
            return raw.split(b"\0")[0].decode("utf-8", "replace")
        value = self._read(name, 0)
        if node.kind == "Enumeration":
            return next((entry for entry, number in node.entries() if number == value), str(int(value)))
        if node.kind == "Boolean":
            return value == node.number("OnValue", 1)
        return value if node.kind in ("Float", "FloatReg", "Converter", "SwissKnife") else int(value)

    def set(self, name: str, value: int | float | str | bool) -> None:
        """Set a feature; an enumeration by the name of its entry. Raises NoFeature."""
        node = self._node(name)
        if node.kind == "Enumeration" and isinstance(value, str):
            entries = dict(node.entries())
            if value not in entries:
                raise NoFeature(f"{name} has no entry {value!r}, but {', '.join(entries)}")
            value = entries[value]
        elif node.kind == "Boolean":
            value = node.number("OnValue", 1) if value else node.number("OffValue", 0)
        if isinstance(value, str):
            raise NoFeature(f"{name} takes a number, and not {value!r}")
        self._write(name, float(value), 0)

    def run(self, name: str) -> None:
        """Execute a command. Raises NoFeature."""
        node = self._node(name)
        if node.kind != "Command":
            raise NoFeature(f"{name} is no command")
        self._write(name, node.number("CommandValue", 1), 0)

    def _node(self, name: str) -> _Node:
        if name not in self._nodes:
            raise NoFeature(f"the camera has no feature {name}")
        return self._nodes[name]

    def _read(self, name: str, depth: int) -> float:
        node = self._deeper(name, depth)
        if node.kind in ("IntReg", "MaskedIntReg", "FloatReg"):
            return node.from_bytes(self._memory.read_memory(self._address(node, depth), node.size()))
        if node.kind in ("Converter", "IntConverter"):
            return self._formula(node, "FormulaFrom", depth, {"TO": self._read(node.text("pValue"), depth + 1)})
        if node.kind in ("SwissKnife", "IntSwissKnife"):
            return self._formula(node, "Formula", depth, {})
        target = node.find("pValue")
        return self._read(target, depth + 1) if target else node.number("Value")

    def _write(self, name: str, value: float, depth: int) -> None:
        node = self._deeper(name, depth)
        if node.kind in ("IntReg", "MaskedIntReg", "FloatReg"):
            address = self._address(node, depth)
            old = self._memory.read_memory(address, node.size()) if node.kind == "MaskedIntReg" else b""
            self._memory.write_memory(address, node.to_bytes(value, old))
        elif node.kind in ("Converter", "IntConverter"):
            self._write(node.text("pValue"), self._formula(node, "FormulaTo", depth, {"FROM": value}), depth + 1)
        elif target := node.find("pValue"):
            self._write(target, value, depth + 1)
        elif node.find("Value"):  # a variable of the description itself, e.g. a selector
            node.keep(value)
        else:
            raise NoFeature(f"{name} cannot be set")

    def _formula(self, node: _Node, tag: str, depth: int, values: dict[str, float]) -> float:
        known = dict(values)
        for name, target in node.variables():
            known[name] = self._read(target, depth + 1)
        try:
            return evaluate(node.text(tag), known)
        except FormulaError as error:
            raise NoFeature(f"the formula of {node.name}: {error}") from error

    def _address(self, node: _Node, depth: int) -> int:
        total = sum(node.whole(text) for text in node.all("Address"))
        total += sum(int(self._read(target, depth + 1)) for target in node.all("pAddress"))
        for offset, target in node.indices():
            total += node.whole(offset) * int(self._read(target, depth + 1))
        if not 0 <= total < 2**32:
            raise NoFeature(f"the address of {node.name} is outside the camera")
        return total

    def _deeper(self, name: str, depth: int) -> _Node:
        if depth > _DEEPEST:
            raise NoFeature(f"the description of {name} refers to itself, or is nested too deeply")
        return self._node(name)


class _Node:
    """One element of the description."""

    def __init__(self, element: ElementTree.Element) -> None:
        self.kind, self.name, self._element = _tag(element), element.get("Name", ""), element

    def all(self, tag: str) -> list[str]:
        return [(child.text or "").strip() for child in self._element if _tag(child) == tag]

    def find(self, tag: str) -> str:
        return next(iter(self.all(tag)), "")

    def text(self, tag: str) -> str:
        if not (found := self.find(tag)):
            raise NoFeature(f"{self.name} has no {tag}")
        return found

    def number(self, tag: str, default: float | None = None) -> float:
        text = self.find(tag)
        if not text and default is not None:
            return default
        try:
            return float(int(text, 0))
        except ValueError:
            pass
        try:
            return float(text)
        except ValueError as error:
            raise NoFeature(f"{tag} of {self.name} is no number: {text!r}") from error

    def whole(self, text: str) -> int:
        try:
            return int(text, 0)
        except ValueError as error:
            raise NoFeature(f"an address of {self.name} is no number: {text!r}") from error

    def keep(self, value: float) -> None:
        next(child for child in self._element if _tag(child) == "Value").text = str(int(value))

    def entries(self) -> Iterator[tuple[str, int]]:
        for child in self._element:
            if _tag(child) == "EnumEntry":
                yield child.get("Name", ""), int(_Node(child).number("Value"))

    def variables(self) -> Iterator[tuple[str, str]]:
        for child in self._element:
            if _tag(child) == "pVariable":
                yield child.get("Name", ""), (child.text or "").strip()

    def indices(self) -> Iterator[tuple[str, str]]:
        for child in self._element:
            if _tag(child) == "pIndex":
                yield child.get("Offset", "0"), (child.text or "").strip()

    def size(self) -> int:
        size = int(self.number("Length"))
        if not 1 <= size <= 4096:
            raise NoFeature(f"{self.name} is {size} bytes long")
        return size

    def _order(self) -> str:
        return ">" if self.find("Endianess") == "BigEndian" else "<"

    def _bits(self) -> tuple[int, int]:
        """(lowest bit, number of bits) of a masked register, bit 0 the least."""
        low, high = (int(self.number("Bit" if self.find("Bit") else tag)) for tag in ("LSB", "MSB"))
        if self._order() == ">":  # in a big-endian register bit 0 is the most significant one
            low, high = (8 * self.size() - 1 - bit for bit in (low, high))
        low, high = min(low, high), max(low, high)
        if low < 0:
            raise NoFeature(f"the bits of {self.name} are outside its register")
        return low, high - low + 1

    def from_bytes(self, raw: bytes) -> float:
        if self.kind == "FloatReg":
            return float(struct.unpack(self._order() + _float_code(self), raw)[0])
        value = int.from_bytes(raw, "big" if self._order() == ">" else "little")
        bits = 8 * len(raw)
        if self.kind == "MaskedIntReg":
            low, bits = self._bits()
            value = value >> low & (1 << bits) - 1
        if self.find("Sign") == "Signed" and value >> (bits - 1):
            value -= 1 << bits
        return value

    def to_bytes(self, value: float, old: bytes) -> bytes:
        size = self.size()
        order: Literal["big", "little"] = "big" if self._order() == ">" else "little"
        if self.kind == "FloatReg":
            return struct.pack(self._order() + _float_code(self), value)
        number = round(value)
        if self.kind == "MaskedIntReg":
            low, bits = self._bits()
            mask = (1 << bits) - 1
            if number & ~mask:
                raise NoFeature(f"{number} does not fit into {self.name}")
            number = int.from_bytes(old, order) & ~(mask << low) | number << low
        try:
            return number.to_bytes(size, order, signed=self.find("Sign") == "Signed")
        except OverflowError as error:
            raise NoFeature(f"{number} does not fit into {self.name}") from error


def _float_code(node: _Node) -> str:
    code = {4: "f", 8: "d"}.get(node.size())
    if code is None:
        raise NoFeature(f"{node.name} is a number of {node.size()} bytes")
    return code


def _tag(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]
