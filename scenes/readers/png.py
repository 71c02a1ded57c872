"""Whether a PNG file is whole (W3C, Portable Network Graphics, third edition, sections 5, 7 and 10).

libpng gives the rows that it could read of a damaged file, and black ones after them.
"""

from __future__ import annotations

import zlib

__all__ = ["png_damage"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Samples per pixel, by colour type.
_SAMPLES = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
#: Adam7: first row and column, step of rows and columns, of each pass.
_PASSES = ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
_MOST_PIXELS = 2**26


def png_damage(content: bytes) -> str:
    """What is wrong with a PNG file; "" if it is whole: every chunk's CRC-32, its end, and as many bytes as rows need."""
    if content[:8] != _SIGNATURE:
        return "it is no PNG file"
    header, data, at, name = b"", [], 8, b""
    while name != b"IEND":
        size, name = int.from_bytes(content[at : at + 4], "big"), content[at + 4 : at + 8]
        if len(name) < 4 or at + 12 + size > len(content):
            return "it ends early"
        body = content[at + 8 : at + 8 + size]
        if zlib.crc32(name + body) != int.from_bytes(content[at + 8 + size : at + 12 + size], "big"):
            return f"the check sum of its part {name.decode('latin-1')!r} is wrong"
        if name == b"IHDR":
            header = body
        elif name == b"IDAT":
            data.append(body)
        at += 12 + size
    if len(header) != 13 or header[9] not in _SAMPLES:
        return "its header is of an unknown form"
    cols, rows = (int.from_bytes(header[i : i + 4], "big") for i in (0, 4))
    wanted = _bytes_of(rows, cols, header[8] * _SAMPLES[header[9]], interlaced=header[12] == 1)
    if rows * cols > _MOST_PIXELS:
        return f"{cols} x {rows} pixels are too many"
    unpack = zlib.decompressobj()
    try:
        found = len(unpack.decompress(b"".join(data), wanted + 1))
    except zlib.error as error:
        return f"its pixels cannot be unpacked: {error}"
    return (
        "" if found >= wanted and (unpack.eof or found > wanted) else f"it holds {found} bytes of pixels, not {wanted}"
    )


def _bytes_of(rows: int, cols: int, bits: int, *, interlaced: bool) -> int:
    """Bytes of all rows, each with its filter's byte."""
    parts = [(rows, cols)]
    if interlaced:
        parts = [(-(-(rows - r) // dr), -(-(cols - c) // dc)) for r, c, dr, dc in _PASSES]
    return sum(r * (1 + -(-c * bits // 8)) for r, c in parts if r > 0 and c > 0)
