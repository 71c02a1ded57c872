"""One image from its packets, in whatever order they come; what is missing is known at any time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .packets import MONO8, MONO16, Kind, Leader, PacketError, StreamPacket, read_leader

__all__ = ["Assembly", "dtype_of"]

_DTYPES = {MONO8: np.dtype("u1"), MONO16: np.dtype("<u2")}


def dtype_of(pixel_format: int) -> Any:
    """The numbers of a pixel format. Raises PacketError for one that is not Mono8 or Mono16."""
    if pixel_format not in _DTYPES:
        raise PacketError(f"the pixel format {pixel_format:#x} is not read; Mono8 and Mono16 are")
    return _DTYPES[pixel_format]


class Assembly:
    """The image `block` of (rows, cols) pixels, of which each packet but the last holds `chunk` bytes.

    The memory it takes follows from what the camera was configured to, never from what a packet says.
    """

    def __init__(self, block: int, rows: int, cols: int, pixel_format: int, chunk: int) -> None:
        self.block, self.shape, self.pixel_format, self.chunk = block, (rows, cols), pixel_format, chunk
        self._bytes = bytearray(rows * cols * dtype_of(pixel_format).itemsize)
        self.count = -(-len(self._bytes) // chunk)
        self._there = np.zeros(self.count + 2, dtype=bool)
        self.leader: Leader | None = None
        self.resent = 0

    def add(self, packet: StreamPacket) -> None:
        """Take one packet of this block. Raises PacketError for one that does not fit the image."""
        if packet.number > self.count + 1:
            raise PacketError(f"packet {packet.number} of an image of {self.count + 2}")
        expected = {0: Kind.LEADER, self.count + 1: Kind.TRAILER}.get(packet.number, Kind.PAYLOAD)
        if packet.kind is not expected:
            raise PacketError(
                f"packet {packet.number} should be {expected.name.lower()}, and is {packet.kind.name.lower()}"
            )
        if packet.kind is Kind.LEADER:
            told = read_leader(packet.body)
            if (told.rows, told.cols) != self.shape or told.pixel_format != self.pixel_format:
                raise PacketError(f"an image of {told.rows} × {told.cols}, and not {self.shape[0]} × {self.shape[1]}")
            self.leader = told
        elif packet.kind is Kind.PAYLOAD:
            start = (packet.number - 1) * self.chunk
            size = min(self.chunk, len(self._bytes) - start)
            if len(packet.body) != size:
                raise PacketError(f"packet {packet.number} holds {len(packet.body)} bytes, and not {size}")
            self._bytes[start : start + size] = packet.body
        self._there[packet.number] = True

    @property
    def complete(self) -> bool:
        """Whether every packet is there."""
        return bool(self._there.all())

    def missing(self) -> list[tuple[int, int]]:
        """Runs (first, last) of packets that are not there."""
        gaps = np.flatnonzero(~self._there)
        if not gaps.size:
            return []
        parts = np.split(gaps, np.flatnonzero(np.diff(gaps) > 1) + 1)
        return [(int(part[0]), int(part[-1])) for part in parts]

    def image(self) -> NDArray[np.unsignedinteger]:
        """The pixels (rows, cols), a copy. Raises PacketError where packets are missing."""
        if not self.complete:
            raise PacketError(f"{int((~self._there).sum())} of {self.count + 2} packets are missing")
        dtype = dtype_of(self.pixel_format)
        return np.frombuffer(bytes(self._bytes), dtype).reshape(self.shape).astype(dtype.newbyteorder("="))
