"""A GigE Vision camera, driven in plain Python: discovery of its description, features, triggers, and images with resend."""

from __future__ import annotations

import contextlib
import io
import re
import socket
import struct
import threading
import time
import zipfile
from collections.abc import Mapping
from typing import Any

from ....scenes.errors import InputError
from ..device import DeviceLost, DeviceTimeout, FrameDamaged, Reading, Settings
from .assembly import Assembly
from .control import Control, RegisterRefused
from .description import Features, NoFeature
from .packets import (
    GVCP_PORT,
    LARGEST_BLOCK,
    STREAM_OVERHEAD,
    PacketError,
    Register,
    Status,
    StreamPacket,
    read_stream,
    resend_request,
)

__all__ = ["GigeCamera"]

#: How long the stream may be silent before missing packets are asked for.
_QUIET_S = 0.02
_MOST_RESENDS = 12
_LARGEST_XML = 16 * 2**20
_LARGEST_IMAGE = 2**30
_URL = re.compile(r"Local:(?:///)?([^;]+);([0-9A-Fa-f]+);([0-9A-Fa-f]+)", re.IGNORECASE)


class GigeCamera:
    """The camera at `address` (HOST or HOST:PORT).

    Other arguments:
        serial: what its serial number must be; "" takes any.
        packet_bytes: size of stream packets with all headers; at most what the network takes whole (1500 without jumbo frames).

    Settings are features of the camera by their own names, and `exposure_s` [s].
    """

    def __init__(self, address: str, *, serial: str = "", packet_bytes: int = 1500) -> None:
        host, _, port = address.partition(":")
        self._host, self._port, self._serial = host, int(port or GVCP_PORT), serial
        self._chunk = packet_bytes - STREAM_OVERHEAD
        self._control: Control | None = None
        self._features: Features | None = None
        self._stream: socket.socket | None = None
        self._heart: threading.Event | None = None
        self._shape, self._format = (0, 0), 0
        self._tick_ns = 1.0
        self._done = 0  # the latest image that was read or given up: its late packets are no news

    # ---------------------------------------------------------------- the protocol

    def open(self) -> Mapping[str, Any]:
        """As `Device.open`. Raises DeviceLost, InputError for a camera of another serial number."""
        self.close()
        self._control = control = Control(self._host, self._port)
        try:
            told = {
                name: control.read_memory(register, size).split(b"\0")[0].decode("utf-8", "replace")
                for name, register, size in (
                    ("vendor", Register.VENDOR, 32), ("model", Register.MODEL, 32),
                    ("serial", Register.SERIAL, 16), ("firmware", Register.FIRMWARE, 32),
                )
            }  # fmt: skip
            if self._serial and told["serial"] != self._serial:
                raise InputError(
                    "Another camera is at this address.", where=f"camera at {self._host}", value=told["serial"],
                    allowed=self._serial, next_step="correct `serial` or `address` in the rig file",
                )  # fmt: skip
            self._take_control(control)
            self._features = Features(self._description(control), control)
            ticks = control.read_register(Register.TICKS_HIGH) << 32 | control.read_register(Register.TICKS_LOW)
            self._tick_ns = 1e9 / ticks if ticks else 0.0
            self._listen(control)
        except (RegisterRefused, NoFeature) as error:
            self.close()
            raise DeviceLost(f"camera at {self._host}: {error}") from error
        except BaseException:
            self.close()
            raise
        return told

    def configure(self, settings: Settings) -> Mapping[str, Any]:
        """As `Device.configure`: the acquisition is stopped, features are set and read, and the acquisition begins."""
        features = self._ready()
        told: dict[str, Any] = {}
        try:
            self._run_if("AcquisitionStop")  # a client that died may have left it running
            for name, value in settings.items():
                told[name] = self._set(features, name, value)
            rows, cols = int(features.get("Height")), int(features.get("Width"))
            self._format = self._format_of(features)
            self._shape = (rows, cols)
            if not 0 < rows * cols * 2 <= _LARGEST_IMAGE:
                raise NoFeature(f"images of {rows} × {cols}")
            Assembly(1, 1, 1, self._format, self._chunk)  # a pixel format that is not read is refused here
            self._aim()
            self._done = 0  # many cameras number anew
            features.run("AcquisitionStart")
        except (NoFeature, PacketError, RegisterRefused) as error:
            if isinstance(error, RegisterRefused) and error.status == Status.ACCESS_DENIED:
                raise DeviceLost(f"camera at {self._host}: {error}") from error
            raise InputError(
                "The camera cannot be set so.", where=f"camera at {self._host}", value=str(error),
                next_step="change the settings of the camera in the rig file",
            ) from error  # fmt: skip
        return told | {"rows": rows, "cols": cols}

    def arm(self) -> None:
        """As `Device.arm`: packets that wait are thrown away."""
        self._ready()
        assert self._stream is not None
        self._stream.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                self._stream.recv(65536)

    def fire(self) -> None:
        """A software trigger."""
        try:
            self._ready().run("TriggerSoftware")
        except (RegisterRefused, NoFeature) as error:
            raise DeviceLost(f"camera at {self._host}: {error}") from error

    def read(self, timeout_s: float) -> Reading:
        """As `Device.read`; packets that were lost are asked for again."""
        self._ready()
        end = time.monotonic() + timeout_s
        assembly: Assembly | None = None
        asked = 0
        while not (assembly is not None and assembly.complete):
            left = end - time.monotonic()
            if left <= 0:
                if assembly is None:
                    raise DeviceTimeout(f"camera at {self._host}: no image in {timeout_s:g} s")
                self._done = assembly.block
                raise FrameDamaged(f"image {assembly.block}: packets {assembly.missing()[:4]} never came")
            packet = self._receive(min(left, _QUIET_S))
            if packet is None:
                if assembly is not None:
                    asked = self._ask_again(assembly, asked)
            elif packet.status >= 0x8000:
                raise FrameDamaged(f"image {packet.block}: the camera no longer has packet {packet.number}")
            elif self._is_news(packet.block) if assembly is None else packet.block == assembly.block:
                if assembly is None:
                    assembly = Assembly(packet.block, *self._shape, self._format, self._chunk)
                self._add(assembly, packet)
        assert assembly.leader is not None
        self._done = assembly.block
        host_ns = time.time_ns()
        device_ns = round(assembly.leader.ticks * self._tick_ns)
        return Reading(assembly.image(), assembly.block, device_ns, host_ns, {"packets_resent": asked})

    def close(self) -> None:
        """As `Device.close`: gives the control of the camera back."""
        if self._heart is not None:
            self._heart.set()
        with contextlib.suppress(Exception):
            self._run_if("AcquisitionStop")
        with contextlib.suppress(Exception):
            if self._control is not None:
                self._control.write_register(Register.CONTROL, 0)
        for one in (self._control, self._stream):
            with contextlib.suppress(Exception):
                if one is not None:
                    one.close()
        self._control = self._features = self._stream = self._heart = None

    # ---------------------------------------------------------------- parts

    def _ready(self) -> Features:
        if self._features is None:
            raise DeviceLost(f"camera at {self._host}: not open")
        return self._features

    def _take_control(self, control: Control) -> None:
        """Become the one client that may write; waits for the heartbeat of one that died."""
        beat_s = max(control.read_register(Register.HEARTBEAT_MS), 500) / 1e3
        end = time.monotonic() + min(beat_s, 10.0) + 1.0
        while True:
            try:
                control.write_register(Register.CONTROL, 2)
                break
            except RegisterRefused as error:
                if time.monotonic() > end:
                    raise DeviceLost(f"camera at {self._host}: another program controls it") from error
                time.sleep(0.1)
        self._heart = threading.Event()
        threading.Thread(target=_beat, args=(control, self._heart, beat_s / 3), daemon=True).start()

    def _description(self, control: Control) -> bytes:
        for register in (Register.FIRST_URL, Register.SECOND_URL):
            url = control.read_memory(register, 512).split(b"\0")[0].decode("ascii", "replace")
            found = _URL.match(url)
            if not found or int(found[3], 16) > _LARGEST_XML:
                continue
            content = control.read_memory(int(found[2], 16), int(found[3], 16))
            return _unpacked(content) if found[1].lower().endswith(".zip") else content
        raise NoFeature("its description is not in its own memory")

    def _listen(self, control: Control) -> None:
        self._stream = stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 * 2**20)
        stream.bind((control.local_host, 0))

    def _aim(self) -> None:
        """Tell the camera where images go, and in what packets."""
        assert self._control is not None and self._stream is not None
        host, port = self._stream.getsockname()
        self._control.write_register(Register.STREAM_ADDRESS, struct.unpack(">I", socket.inet_aton(host))[0])
        self._control.write_register(Register.STREAM_PORT, port)
        self._control.write_register(Register.PACKET_SIZE, self._chunk + STREAM_OVERHEAD)
        # Cameras round the size to what they can send.
        size = self._control.read_register(Register.PACKET_SIZE) & 0xFFFF
        if size <= STREAM_OVERHEAD:
            raise NoFeature(f"packets of {size} bytes")
        self._chunk = size - STREAM_OVERHEAD

    def _set(self, features: Features, name: str, value: Any) -> Any:
        if name != "exposure_s":
            features.set(name, value)
            return features.get(name)
        known = next((one for one in ("ExposureTime", "ExposureTimeAbs") if one in features), None)
        if known is None:
            raise NoFeature("the camera has no exposure that can be set")
        features.set(known, float(value) * 1e6)
        return float(features.get(known)) * 1e-6

    def _format_of(self, features: Features) -> int:
        name = str(features.get("PixelFormat"))
        known = {"Mono8": 0x01080001, "Mono16": 0x01100007}
        if name not in known:
            raise NoFeature(f"PixelFormat {name}: Mono8 and Mono16 are read")
        return known[name]

    def _run_if(self, name: str) -> None:
        if self._features is not None and name in self._features:
            self._features.run(name)

    def _receive(self, wait_s: float) -> StreamPacket | None:
        """A packet from the camera; None where none comes in time, or what came is no packet of an image."""
        assert self._stream is not None
        self._stream.settimeout(max(wait_s, 1e-4))
        try:
            data, sender = self._stream.recvfrom(65536)
            if sender[0] == self._host or not _numeric(self._host):
                return read_stream(data)
        except (TimeoutError, PacketError):
            pass
        except OSError as error:
            raise DeviceLost(f"camera at {self._host}: {error.strerror or error}") from error
        return None

    def _add(self, assembly: Assembly, packet: StreamPacket) -> None:
        try:
            assembly.add(packet)
        except PacketError as error:
            self._done = assembly.block
            raise FrameDamaged(f"image {assembly.block}: {error}") from error

    def _is_news(self, block: int) -> bool:
        """Whether an image comes after all that were read: identifiers count up, and wrap."""
        return not self._done or 0 < (block - self._done) % LARGEST_BLOCK < LARGEST_BLOCK // 2

    def _ask_again(self, assembly: Assembly, asked: int) -> int:
        """Ask for what is missing; how many packets were asked for in all. Raises FrameDamaged beyond a limit."""
        assert self._control is not None
        runs = assembly.missing()
        assembly.resent += 1
        if assembly.resent > _MOST_RESENDS:
            self._done = assembly.block
            raise FrameDamaged(f"image {assembly.block}: packets {runs[:4]} were asked for {_MOST_RESENDS} times")
        for number, (first, last) in enumerate(runs[:64]):
            self._control.tell(resend_request(number + 1, assembly.block, first, last))
            asked += last - first + 1
        return asked


def _beat(control: Control, stop: threading.Event, every_s: float) -> None:
    """Read the control register now and then: a camera lets go of a client that it does not hear from."""
    while not stop.wait(every_s):
        with contextlib.suppress(DeviceLost, RegisterRefused, OSError):
            control.read_register(Register.CONTROL)


def _unpacked(content: bytes) -> bytes:
    """The first file of a zip archive, at most `_LARGEST_XML` bytes. Raises NoFeature."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive, archive.open(archive.namelist()[0]) as file:
            return file.read(_LARGEST_XML)
    except (zipfile.BadZipFile, IndexError, OSError, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        raise NoFeature(f"its packed description is damaged: {error}") from error


def _numeric(host: str) -> bool:
    return re.fullmatch(r"[0-9.]+", host) is not None
