"""Commands and answers as text over TCP, and binary blocks (IEEE 488.2), which may hold any byte.

Two things that bite: with Nagle's algorithm on, each set-then-ask costs 40 to 90 ms, so it is off, and set and query go out in
one write; and after a timeout the late answer would be taken for that of the *next* query, so the connection is closed then.
"""

from __future__ import annotations

import contextlib
import socket
import time

from .device import DeviceLost, DeviceTimeout, FrameDamaged

__all__ = ["ScpiLink", "block_size"]

_LONGEST_ANSWER = 4096
_LARGEST_BLOCK = 2**30


class ScpiLink:
    """A connection to `address` (HOST:PORT). It is made when it is needed, and made again after a timeout."""

    def __init__(self, address: str, *, port: int = 5025, timeout_s: float = 2.0) -> None:
        host, _, given = address.partition(":")
        self._peer, self._timeout_s = (host, int(given or port)), timeout_s
        self._socket: socket.socket | None = None
        self._rest = b""

    def __str__(self) -> str:
        return f"{self._peer[0]}:{self._peer[1]}"

    def open(self) -> None:
        """Connect. Raises DeviceLost."""
        self.close()
        try:
            self._socket = socket.create_connection(self._peer, self._timeout_s)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            self.close()
            raise DeviceLost(f"{self}: {error.strerror or error}") from error

    def close(self) -> None:
        """Disconnect; never raises."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket, self._rest = None, b""

    def tell(self, *commands: str) -> None:
        """Send commands that have no answer, in one write. Raises DeviceLost."""
        if self._socket is None:
            self.open()
        assert self._socket is not None
        try:
            self._socket.sendall((";".join(commands) + "\n").encode("ascii"))
        except OSError as error:
            self.close()
            raise DeviceLost(f"{self}: {error.strerror or error}") from error

    def ask(self, *commands: str) -> list[str]:
        """Send commands in one write; the answers of those that are queries. Raises DeviceTimeout, DeviceLost."""
        self.tell(*commands)
        return [self.line() for command in commands if "?" in command]

    def line(self) -> str:
        """One line of text. Raises DeviceTimeout, DeviceLost."""
        end = time.monotonic() + self._timeout_s
        while b"\n" not in self._rest:
            if len(self._rest) > _LONGEST_ANSWER:
                self.close()
                raise DeviceLost(f"{self}: an answer without an end")
            self._more(end)
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode("ascii", "replace").strip()

    def block(self, command: str, timeout_s: float) -> bytes:
        """The binary block that answers a query: it ends where its header says, never at a line feed.

        Raises DeviceTimeout, DeviceLost, FrameDamaged for what is no block.
        """
        self.tell(command)
        end = time.monotonic() + timeout_s
        while (size := block_size(self._rest)) is None:
            self._more(end)
        start, length = size
        if length > _LARGEST_BLOCK or start == 0:
            self.close()
            raise FrameDamaged(f"{self}: the answer is no binary block of at most {_LARGEST_BLOCK} bytes")
        while len(self._rest) < start + length + 1:  # and the line feed behind it
            self._more(end)
        data, self._rest = self._rest[start : start + length], self._rest[start + length :].lstrip(b"\r\n")
        return data

    def _more(self, end: float) -> None:
        if self._socket is None:
            raise DeviceLost(f"{self}: not open")
        try:
            self._socket.settimeout(max(end - time.monotonic(), 1e-3))
            data = self._socket.recv(65536)
        except TimeoutError as error:
            self.close()  # the late answer must not be taken for the next one
            raise DeviceTimeout(f"{self}: no answer in time") from error
        except OSError as error:
            self.close()
            raise DeviceLost(f"{self}: {error.strerror or error}") from error
        if not data:
            self.close()
            raise DeviceLost(f"{self}: the connection ended")
        self._rest += data


def block_size(head: bytes) -> tuple[int, int] | None:
    """(where the data begin, number of bytes) of the block that begins with `head`; None where more of it is needed, (0, 0) for
    what is no block of definite length: #, a digit n, n digits of the length, the data (IEEE 488.2, 8.7.9)."""
    if not head:
        return None
    if head[:1] != b"#":
        return 0, 0
    if len(head) < 2:
        return None
    digits = head[1] - 48
    if not 1 <= digits <= 9:
        return 0, 0
    if len(head) < 2 + digits:
        return None if head[2:].isdigit() or len(head) == 2 else (0, 0)
    length = head[2 : 2 + digits]
    return (2 + digits, int(length)) if length.isdigit() else (0, 0)
