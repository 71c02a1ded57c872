"""The control channel of a GigE camera: registers and memory by UDP, one command in flight, repeated where no answer comes."""

from __future__ import annotations

import socket
import struct
import threading
import time

from ..device import DeviceLost
from .packets import GVCP_PORT, Command, Message, PacketError, Status, command, read_acknowledge

__all__ = ["Control", "RegisterRefused"]

_TRIES = 4
_WAIT_S = 0.25
#: Longest read of memory in one command.
_PIECE = 512
#: An answer may be put off ("pending"), but not for ever.
_LONGEST_S = 5.0


class RegisterRefused(Exception):
    """The camera answered, and refused; `status` says why."""

    def __init__(self, what: str, status: int) -> None:
        self.status = status
        name = (
            Status(status).name.lower().replace("_", " ") if status in Status._value2member_map_ else f"{status:#06x}"
        )
        super().__init__(f"{what}: {name}")


class Control:
    """A client's side of the control channel of the camera at `host`:`port`. May be used by several threads."""

    def __init__(self, host: str, port: int = GVCP_PORT) -> None:
        self._peer = (host, port)
        self._lock = threading.Lock()
        self._ident = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect(self._peer)  # so that only this camera is heard
        except OSError as error:
            self._socket.close()
            raise DeviceLost(f"{host}:{port}: {error.strerror or error}") from error

    @property
    def local_host(self) -> str:
        """Address of this machine as the camera sees it."""
        return str(self._socket.getsockname()[0])

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def read_register(self, address: int) -> int:
        """Value of a register. Raises DeviceLost, RegisterRefused."""
        body = self._ask(Command.READ_REGISTER, struct.pack(">I", address), 4, f"reading register {address:#x}")
        return int(struct.unpack(">I", body[:4])[0])

    def write_register(self, address: int, value: int) -> None:
        """Set a register. Raises DeviceLost, RegisterRefused."""
        body = struct.pack(">II", address, value & 0xFFFFFFFF)
        self._ask(Command.WRITE_REGISTER, body, 0, f"writing {value:#x} to register {address:#x}")

    def read_memory(self, address: int, size: int) -> bytes:
        """`size` bytes from `address` on. Raises DeviceLost, RegisterRefused."""
        parts = []
        end = address + (size + 3 & ~3)  # only whole words are read
        for start in range(address, end, _PIECE):
            count = min(_PIECE, end - start)
            body = self._ask(
                Command.READ_MEMORY, struct.pack(">IHH", start, 0, count), 4 + count, f"reading memory at {start:#x}"
            )
            parts.append(body[4 : 4 + count])
        return b"".join(parts)[:size]

    def write_memory(self, address: int, data: bytes) -> None:
        """Write bytes, whole words. Raises DeviceLost, RegisterRefused."""
        for start in range(0, len(data), _PIECE):
            piece = data[start : start + _PIECE]
            body = struct.pack(">I", address + start) + piece
            self._ask(Command.WRITE_MEMORY, body, 0, f"writing memory at {address + start:#x}")

    def tell(self, packet_of: bytes) -> None:
        """Send a packet that nothing acknowledges."""
        try:
            self._socket.send(packet_of)
        except OSError as error:
            raise DeviceLost(f"{self._peer[0]}: {error.strerror or error}") from error

    def _ask(self, kind: Command, body: bytes, least: int, doing: str) -> bytes:
        with self._lock:
            answer = self._exchange(kind, body, doing)
        if answer.status != Status.SUCCESS:
            raise RegisterRefused(doing, answer.status)
        if len(answer.body) < least:
            raise DeviceLost(f"{doing}: the camera answers {len(answer.body)} bytes, and not {least}")
        return answer.body

    def _exchange(self, kind: Command, body: bytes, doing: str) -> Message:
        self._ident = self._ident % 0xFFFF + 1  # never 0
        packet = command(kind, self._ident, body)
        for _ in range(_TRIES):
            try:
                self._socket.send(packet)
                answer = self._answer(kind)
            except OSError as error:  # refused: no process listens there
                time.sleep(_WAIT_S / _TRIES)
                last: OSError | None = error
                continue
            last = None
            if answer is not None:
                return answer
        said = f": {last.strerror or last}" if last else ""
        raise DeviceLost(f"{doing}: no answer from {self._peer[0]}:{self._peer[1]}{said}")

    def _answer(self, kind: Command) -> Message | None:
        """The acknowledge of the command just sent; None where none comes in time. Raises OSError."""
        end = time.monotonic() + _WAIT_S
        limit = time.monotonic() + _LONGEST_S
        while (left := min(end, limit) - time.monotonic()) > 0:
            self._socket.settimeout(left)
            try:
                message = read_acknowledge(self._socket.recv(2048))
            except TimeoutError:
                return None
            except PacketError:
                continue  # whatever it is, it is not our answer
            if message.ident != self._ident:
                continue  # the late answer to an earlier command
            if message.kind == Command.PENDING + 1:
                end = time.monotonic() + _WAIT_S + int.from_bytes(message.body[2:4], "big") / 1e3
            elif message.kind == kind + 1:
                return message
        return None
