"""An emulated GigE Vision camera: control and stream channel on one address, with losses on request."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...captures.drivers.gige.packets import (
    GVCP_PORT,
    MONO16,
    STREAM_OVERHEAD,
    Command,
    Message,
    PacketError,
    Register,
    Status,
    acknowledge,
    leader,
    next_block,
    payload,
    read_command,
    trailer,
)
from .features import FEATURES, bootstrap, description

__all__ = ["EmulatedCamera"]

_SIZE = 0x40000
#: Images that can still be sent again.
_KEPT = 4
_FREE_RUN_S = 0.05


class EmulatedCamera:
    """A camera of (rows, cols) pixels of 16 bits at `host`.

    Main arguments:
        expose: called where the camera triggers itself (by software, or without trigger); it calls `send` or not.
    Other arguments:
        loss: probability that a packet of the stream, sent or sent again, never arrives; drawn from `draw`.
        listen: address of the control channel, `host` by default; "" hears broadcasts too, by which clients discover cameras.
    """

    def __init__(
        self, host: str, rows: int, cols: int, *, serial: str, expose: Callable[[], None], draw: np.random.Generator,
        loss: float = 0.0, port: int = GVCP_PORT,
        listen: str | None = None,
    ) -> None:  # fmt: skip
        self._memory = bytearray(_SIZE)
        for address, content in bootstrap(host, serial, rows, cols, description()).items():
            self._memory[address : address + len(content)] = content
        self._expose, self._draw, self._loss = expose, draw, loss
        self._control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._control.bind((host if listen is None else listen, port))
        self._stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._stream.bind((host, 0))
        self._owner: tuple[tuple[str, int] | None, float] = (None, 0.0)
        self._lock = threading.RLock()
        self._running = threading.Event()
        self._block = 0
        self._closed = False
        self._kept: OrderedDict[int, list[bytes]] = OrderedDict()

    def start(self) -> None:
        """Serve in threads of their own, for as long as the process lives."""
        threading.Thread(target=self._serve, daemon=True).start()
        threading.Thread(target=self._run_free, daemon=True).start()

    def close(self) -> None:
        """Stop serving."""
        self._closed = True
        self._running.set()  # the free run ends too
        for one in (self._control, self._stream):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    @property
    def address(self) -> tuple[str, int]:
        """(host, port) of the control channel."""
        host, port = self._control.getsockname()
        return host, port

    @property
    def exposure_s(self) -> float:
        """The exposure that is set, s."""
        return self._word(FEATURES["ExposureTime"].address) * 1e-6

    def waits_for(self, source: str) -> bool:
        """Whether a trigger from this source would begin an image."""
        chosen = self._word(FEATURES["TriggerSource"].address) == dict(FEATURES["TriggerSource"].entries)[source]
        return self._running.is_set() and bool(self._word(FEATURES["TriggerMode"].address)) and chosen

    def send(self, image: NDArray[np.uint16]) -> None:
        """Send one image, in the packets and to the place that the client asked for."""
        with self._lock:
            self._block = next_block(self._block)
            rows, cols = image.shape
            data = image.astype("<u2").tobytes()
            chunk = max((self._word(Register.PACKET_SIZE) & 0xFFFF) - STREAM_OVERHEAD, 64)
            pieces = [data[start : start + chunk] for start in range(0, len(data), chunk)]
            packets = [leader(self._block, time.monotonic_ns(), MONO16, cols, rows)]
            packets += [payload(self._block, number, piece) for number, piece in enumerate(pieces, 1)]
            packets.append(trailer(self._block, len(packets), rows))
            self._kept[self._block] = packets
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
            for packet in packets:
                self._put(packet)

    def _put(self, packet: bytes) -> None:
        host = socket.inet_ntoa(struct.pack(">I", self._word(Register.STREAM_ADDRESS)))
        port = self._word(Register.STREAM_PORT) & 0xFFFF
        if port and not (self._loss and self._draw.random() < self._loss):
            with contextlib.suppress(OSError):  # nobody listens there any more, as on a wire
                self._stream.sendto(packet, (host, port))

    # ---------------------------------------------------------------- control

    def _serve(self) -> None:
        while True:
            try:
                packet, peer = self._control.recvfrom(2048)
                message = read_command(packet)
            except PacketError:
                continue
            except OSError:
                return
            answer = self._answer(message, peer)
            if answer is not None and message.wants_answer:
                with contextlib.suppress(OSError):
                    self._control.sendto(answer, peer)

    def _answer(self, message: Message, peer: tuple[str, int]) -> bytes | None:
        if self._owner[0] == peer:
            self._owner = (peer, time.monotonic())
        try:
            if message.kind == Command.DISCOVERY:
                return acknowledge(message.kind, message.ident, bytes(self._memory[:0xF8]))
            if message.kind == Command.PACKET_RESEND:
                self._resend(message.body)
                return None
            body = _HANDLERS[message.kind](self, message.body, peer)
            return acknowledge(message.kind, message.ident, body)
        except _Refused as error:
            return acknowledge(message.kind, message.ident, b"", error.status)
        except KeyError:
            return acknowledge(message.kind, message.ident, b"", Status.NOT_IMPLEMENTED)
        except struct.error:
            return acknowledge(message.kind, message.ident, b"", Status.INVALID_PARAMETER)

    def _read_registers(self, body: bytes, peer: Any) -> bytes:
        return b"".join(self._bytes(address, 4) for (address,) in struct.iter_unpack(">I", body))

    def _write_registers(self, body: bytes, peer: tuple[str, int]) -> bytes:
        pairs = list(struct.iter_unpack(">II", body))
        for address, value in pairs:
            self._write(address, struct.pack(">I", value), peer)
        return struct.pack(">HH", 0, len(pairs))

    def _read_memory(self, body: bytes, peer: Any) -> bytes:
        address, _, count = struct.unpack(">IHH", body)
        if count > 536:
            raise _Refused(Status.INVALID_PARAMETER)
        return body[:4] + self._bytes(address, count)

    def _write_memory(self, body: bytes, peer: tuple[str, int]) -> bytes:
        (address,) = struct.unpack_from(">I", body)
        self._write(address, body[4:], peer)
        return struct.pack(">HH", 0, len(body) - 4)

    def _bytes(self, address: int, count: int) -> bytes:
        if address + count > _SIZE:
            raise _Refused(Status.INVALID_ADDRESS)
        return bytes(self._memory[address : address + count])

    def _word(self, address: int) -> int:
        return int(struct.unpack_from(">I", self._memory, address)[0])

    def _write(self, address: int, data: bytes, peer: tuple[str, int]) -> None:
        owner, heard = self._owner
        alive = owner is not None and time.monotonic() - heard < self._word(Register.HEARTBEAT_MS) / 1e3
        if alive and owner != peer:
            raise _Refused(Status.ACCESS_DENIED)
        if address == Register.CONTROL:
            self._owner = (peer, time.monotonic()) if any(data) else (None, 0.0)
        elif owner != peer:
            raise _Refused(Status.ACCESS_DENIED)
        names = {feature.address: name for name, feature in FEATURES.items()}
        name = names.get(address, "")
        if name and FEATURES[name].fixed:
            raise _Refused(Status.WRITE_PROTECT)
        if not name and address >= min(one.address for one in FEATURES.values() if one.address > 0xFFFF):
            raise _Refused(Status.INVALID_ADDRESS)
        if name and FEATURES[name].entries and int.from_bytes(data, "big") not in dict(FEATURES[name].entries).values():
            raise _Refused(Status.INVALID_PARAMETER)
        self._memory[address : address + len(data)] = data
        self._acted(name)

    def _acted(self, name: str) -> None:
        if name == "AcquisitionStart":
            self._running.set()
        elif name == "AcquisitionStop":
            self._running.clear()
        elif name == "TriggerSoftware" and self.waits_for("Software"):
            threading.Thread(target=self._expose, daemon=True).start()

    def _resend(self, body: bytes) -> None:
        _, block, first, last = struct.unpack_from(">HHII", body)
        with self._lock:
            packets = self._kept.get(block, [])
            for number in range(first & 0xFFFFFF, min(last & 0xFFFFFF, len(packets) + 1) + 1):
                if number < len(packets):
                    self._put(struct.pack(">H", Status.RESENT) + packets[number][2:])
                else:
                    self._put(payload(block, number, b"", Status.PACKET_UNAVAILABLE))

    def _run_free(self) -> None:
        while self._running.wait() and not self._closed:
            if not self._word(FEATURES["TriggerMode"].address):
                self._expose()
            time.sleep(_FREE_RUN_S)


class _Refused(Exception):
    def __init__(self, status: Status) -> None:
        self.status = status
        super().__init__(status)


_HANDLERS: dict[int, Callable[[EmulatedCamera, bytes, tuple[str, int]], bytes]] = {
    Command.READ_REGISTER: EmulatedCamera._read_registers,
    Command.WRITE_REGISTER: EmulatedCamera._write_registers,
    Command.READ_MEMORY: EmulatedCamera._read_memory,
    Command.WRITE_MEMORY: EmulatedCamera._write_memory,
}
