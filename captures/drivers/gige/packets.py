"""Packets of GigE Vision: control (GVCP) and stream (GVSP), to bytes and from bytes. Both sides use this file.

Source: the header layouts that open implementations agree on (Aravis 0.8, `arvgvcpprivate.h` and `arvgvspprivate.h`; the
dissectors of Wireshark, `packet-gvcp.c` and `packet-gvsp.c`). All numbers are big-endian. Only what a camera of one stream
with 16-bit block identifiers needs is here; anything else raises PacketError, whatever bytes come.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

__all__ = [
    "GVCP_PORT", "LARGEST_BLOCK", "MONO16", "MONO8", "STREAM_OVERHEAD", "Command", "Kind", "Leader", "Message", "PacketError",
    "Register", "Status", "StreamPacket", "acknowledge", "command", "leader", "next_block", "payload", "read_acknowledge",
    "read_command", "read_leader", "read_stream", "resend_request", "trailer",
]  # fmt: skip

GVCP_PORT = 3956
_KEY = 0x42
#: Largest body of a control packet: 548 bytes are guaranteed to pass, and 576 is the datagram that every host takes.
_LARGEST_BODY = 548
#: IP, UDP and GVSP headers, which the packet size of a camera counts.
STREAM_OVERHEAD = 20 + 8 + 8
#: Block identifiers run 1 … 65535 and then 1 again; 0 is reserved.
LARGEST_BLOCK = 65535

MONO8 = 0x01080001
MONO16 = 0x01100007

_COMMAND = struct.Struct(">BBHHH")
_ACKNOWLEDGE = struct.Struct(">HHHH")
_STREAM = struct.Struct(">HHI")
_LEADER = struct.Struct(">HHIIIIIIIHH")
_IMAGE = 1


class PacketError(ValueError):
    """Bytes that are no packet of GigE Vision."""


class Command(IntEnum):
    """Commands of the control channel; the acknowledge of each is one more."""

    DISCOVERY = 0x0002
    PACKET_RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086
    PENDING = 0x0088


class Status(IntEnum):
    """Status of an acknowledge or of a stream packet."""

    SUCCESS = 0x0000
    RESENT = 0x0100
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    ACCESS_DENIED = 0x8006
    PACKET_UNAVAILABLE = 0x800C


class Register(IntEnum):
    """Bootstrap registers that every camera has."""

    VERSION = 0x0000
    DEVICE_MODE = 0x0004
    MAC_HIGH = 0x0008
    MAC_LOW = 0x000C
    CURRENT_IP = 0x0024
    VENDOR = 0x0048
    MODEL = 0x0068
    FIRMWARE = 0x0088
    SERIAL = 0x00D8
    FIRST_URL = 0x0200
    SECOND_URL = 0x0400
    INTERFACES = 0x0600
    STREAMS = 0x0904
    CAPABILITY = 0x0934
    HEARTBEAT_MS = 0x0938
    TICKS_HIGH = 0x093C
    TICKS_LOW = 0x0940
    CONTROL = 0x0A00
    STREAM_PORT = 0x0D00
    PACKET_SIZE = 0x0D04
    STREAM_ADDRESS = 0x0D18


class Kind(IntEnum):
    """Packets of the stream channel."""

    LEADER = 1
    TRAILER = 2
    PAYLOAD = 3


@dataclass(frozen=True)
class Message:
    """A control packet: `kind` (command or acknowledge), `ident` (chosen by the client), `body`; `status` of an acknowledge."""

    kind: int
    ident: int
    body: bytes
    status: int = 0
    wants_answer: bool = True


@dataclass(frozen=True)
class StreamPacket:
    """A packet of an image: `block` (the image's number), `number` of the packet in it, `body`."""

    kind: Kind
    block: int
    number: int
    body: bytes
    status: int = 0


@dataclass(frozen=True)
class Leader:
    """What the first packet of an image says: `ticks` of the camera's clock, pixel format, columns and rows."""

    ticks: int
    pixel_format: int
    cols: int
    rows: int


def command(kind: int, ident: int, body: bytes = b"", *, answer: bool = True) -> bytes:
    """A command of the control channel."""
    return _COMMAND.pack(_KEY, 1 if answer else 0, kind, len(body), ident) + body


def acknowledge(kind: int, ident: int, body: bytes = b"", status: int = 0) -> bytes:
    """The answer to the command `kind`."""
    return _ACKNOWLEDGE.pack(status, kind + 1, len(body), ident) + body


def read_command(packet: bytes) -> Message:
    """A command from bytes. Raises PacketError."""
    if len(packet) < _COMMAND.size:
        raise PacketError("shorter than a header")
    key, flags, kind, length, ident = _COMMAND.unpack_from(packet)
    if key != _KEY:
        raise PacketError("not a command")
    return Message(kind, ident, _body(packet, _COMMAND.size, length), wants_answer=bool(flags & 1))


def read_acknowledge(packet: bytes) -> Message:
    """An acknowledge from bytes; its kind is that of the acknowledge, one more than the command's. Raises PacketError."""
    if len(packet) < _ACKNOWLEDGE.size:
        raise PacketError("shorter than a header")
    status, kind, length, ident = _ACKNOWLEDGE.unpack_from(packet)
    return Message(kind, ident, _body(packet, _ACKNOWLEDGE.size, length), status)


def _body(packet: bytes, start: int, length: int) -> bytes:
    if length > _LARGEST_BODY or len(packet) < start + length:
        raise PacketError("its length is not that of its body")
    return packet[start : start + length]


def resend_request(ident: int, block: int, first: int, last: int) -> bytes:
    """Ask for packets `first` … `last` of an image once more; nothing acknowledges it."""
    return command(Command.PACKET_RESEND, ident, struct.pack(">HHII", 0, block, first, last), answer=False)


def next_block(block: int) -> int:
    """The identifier after `block`: 65535 is followed by 1."""
    return block % LARGEST_BLOCK + 1


def leader(block: int, ticks: int, pixel_format: int, cols: int, rows: int, status: int = 0) -> bytes:
    """The first packet of an image."""
    body = _LEADER.pack(0, _IMAGE, ticks >> 32, ticks & 0xFFFFFFFF, pixel_format, cols, rows, 0, 0, 0, 0)
    return _stream(Kind.LEADER, block, 0, body, status)


def payload(block: int, number: int, data: bytes, status: int = 0) -> bytes:
    """The packet `number` (1, 2, …) of an image."""
    return _stream(Kind.PAYLOAD, block, number, data, status)


def trailer(block: int, number: int, rows: int, status: int = 0) -> bytes:
    """The last packet of an image."""
    return _stream(Kind.TRAILER, block, number, struct.pack(">HHI", 0, _IMAGE, rows), status)


def _stream(kind: Kind, block: int, number: int, body: bytes, status: int) -> bytes:
    return _STREAM.pack(status, block, (int(kind) << 24) | number) + body


def read_stream(packet: bytes) -> StreamPacket:
    """A packet of an image from bytes. Raises PacketError: extended identifiers, no such kind, block 0."""
    if len(packet) < _STREAM.size:
        raise PacketError("shorter than a header")
    status, block, word = _STREAM.unpack_from(packet)
    kind = word >> 24
    if kind & 0x80:
        raise PacketError("64-bit block identifiers, which were not agreed on")
    if kind not in (Kind.LEADER, Kind.TRAILER, Kind.PAYLOAD):
        raise PacketError(f"packets of kind {kind} hold no image")
    if block == 0 and status < 0x8000:
        raise PacketError("block 0 is reserved")
    return StreamPacket(Kind(kind), block, word & 0xFFFFFF, packet[_STREAM.size :], status)


def read_leader(body: bytes) -> Leader:
    """What the first packet says. Raises PacketError: too short, or the payload is no image."""
    if len(body) < _LEADER.size:
        raise PacketError("a leader that is too short")
    _, kind, high, low, pixel_format, cols, rows, *_ = _LEADER.unpack_from(body)
    if kind & 0x3FFF != _IMAGE:  # the two top bits say that chunks follow
        raise PacketError(f"the payload {kind:#x} is no image")
    return Leader((high << 32) | low, pixel_format, cols, rows)
