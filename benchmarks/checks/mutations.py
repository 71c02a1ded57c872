"""Random changes of the bytes of a file, for the campaigns of fuzzed inputs: of bits, of runs of bytes, and of words."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["json_mutated", "mutated"]

#: Values that a field of a file is replaced by.
_ODD: tuple[Any, ...] = (
    None, True, -1, 0, 2**31, 2**63, 10**15, -(10**15), 1e308, -1e308, 1e-320, "", "x", "../x", "/etc/passwd", "\ud800", "a\x1b[2J",
    [], {}, [[]], {"a": []}, [1e300], "9" * 50,
)  # fmt: skip
_WORDS = (
    b"1e999", b"-1e308", b"nan", b"inf", b"9" * 5000, b"-1", b"0", b"[" * 3000, b"{" * 3000, b"\x00", b"\xff\xfe", b"\xed\xa0\x80",
    b"null", b"true", b"a." * 3000, b"\n", b'"', b"#", b"../../x", b"1_0", b"999999999999",
)  # fmt: skip


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """The content after one to four random changes."""
    for _ in range(int(rng.integers(1, 5))):
        content = _CHANGES[int(rng.integers(len(_CHANGES)))](content, rng)
    return content[: 2**24]


def _place(content: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(content))) if content else 0


def _bits(content: bytes, rng: np.random.Generator) -> bytes:
    made = bytearray(content)
    for _ in range(int(rng.integers(1, 9))):
        if made:
            made[_place(content, rng)] ^= 1 << int(rng.integers(8))
    return bytes(made)


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: _place(content, rng)]


def _without(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + content[at + int(rng.integers(1, 64)) :]


def _again(content: bytes, rng: np.random.Generator) -> bytes:
    at, size = _place(content, rng), int(rng.integers(1, 256))
    return content[:at] + content[at : at + size] * int(rng.integers(2, 40)) + content[at:]


def _noise(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + rng.bytes(int(rng.integers(1, 64))) + content[at + int(rng.integers(0, 64)) :]


def _number(content: bytes, rng: np.random.Generator) -> bytes:
    """Four or eight bytes as an extreme whole number, as a binary header may hold."""
    at, size = _place(content, rng), int(rng.choice([2, 4, 8]))
    value = (0, 1, 2 ** (8 * size) - 1, 2 ** (8 * size - 1), 2 ** (8 * size - 2))[int(rng.integers(5))]
    order: Any = ("little", "big")[int(rng.integers(2))]
    return content[:at] + value.to_bytes(size, order) + content[at + size :]


def _word(content: bytes, rng: np.random.Generator) -> bytes:
    """A word of a text, from sign to sign, replaced by an odd one."""
    signs = b" \t\n,:=[]{}/"
    at = _place(content, rng)
    start, end = at, at
    while start > 0 and content[start - 1] not in signs and at - start < 64:
        start -= 1
    while end < len(content) and content[end] not in signs and end - at < 64:
        end += 1
    return content[:start] + _WORDS[int(rng.integers(len(_WORDS)))] + content[end:]


def _packed(content: bytes, rng: np.random.Generator) -> bytes:
    """The change of what a gzip file holds."""
    if content[:2] != b"\x1f\x8b":
        return _word(content, rng)
    try:
        return gzip.compress(mutated(gzip.decompress(content), rng), 1)
    except (OSError, EOFError, ValueError, zlib.error):
        return content


_CHANGES: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _bits, _cut, _without, _again, _noise, _number, _word, _word, _word, _packed,
)  # fmt: skip


def json_mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A JSON text in which one value is replaced by an odd one, or removed: the text itself stays well formed."""
    body = json.loads(content)
    places: list[tuple[Any, Any]] = []
    ahead = [body]
    while ahead:
        node = ahead.pop()
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else []
        places += [(node, key) for key in keys]
        ahead += [node[key] for key in keys]
    if not places:
        return content
    node, key = places[int(rng.integers(len(places)))]
    value = _ODD[int(rng.integers(len(_ODD)))]
    if rng.random() < 0.15:
        del node[key]
    elif isinstance(node[key], str) and node[key][:1] in ("{", "[") and rng.random() < 0.7:
        try:
            node[key] = json_mutated(node[key].encode(), rng).decode("utf-8", "surrogatepass")
        except ValueError:
            node[key] = value
    else:
        node[key] = value
    return json.dumps(body).encode()
