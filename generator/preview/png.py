"""A picture as the bytes of a PNG file."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

__all__ = ["png"]


def png(picture: NDArray[np.uint8]) -> bytes:
    """The bytes of a PNG file in sRGB (ISO 15948), rows filtered as differences to the row above.

    Encoded in memory: libraries that write the file themselves do not report a disk that fills up at the end.

    Main arguments:
        picture: (rows, cols, channels), 1 to 4 channels.
    """

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows, cols, channels = picture.shape
    lines = np.asarray(picture, np.uint8).reshape(rows, cols * channels)
    filtered = np.full((rows, 1 + cols * channels), 2, np.uint8)
    filtered[:, 1:] = np.diff(lines, axis=0, prepend=np.zeros_like(lines[:1]))  # modulo 256, as the filter is
    header = struct.pack(">IIBBBBB", cols, rows, 8, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)
    parts = ((b"IHDR", header), (b"sRGB", b"\0"), (b"IDAT", zlib.compress(filtered.tobytes(), 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(kind, data) for kind, data in parts)
