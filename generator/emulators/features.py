"""What the emulated GigE camera is: its registers, and the description (GenICam XML) that names them."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from ...captures.drivers.gige.packets import MONO16, Register

__all__ = ["FEATURES", "Feature", "bootstrap", "description"]

#: Where the description lies in the camera's memory.
XML_ADDRESS = 0x20000


@dataclass(frozen=True)
class Feature:
    """A register: its address, the value at the start, the entries of an enumeration, whether it can be set."""

    address: int
    value: int = 0
    entries: tuple[tuple[str, int], ...] = ()
    kind: str = "Integer"
    fixed: bool = False
    unit: str = ""


_OFF_ON = (("Off", 0), ("On", 1))
#: The features, by their standard names (EMVA SFNC 2.7). ExposureTime is in µs, in steps of one.
FEATURES: dict[str, Feature] = {
    "SensorWidth": Feature(0x10000, fixed=True),
    "SensorHeight": Feature(0x10004, fixed=True),
    "Width": Feature(0x10008, fixed=True),
    "Height": Feature(0x1000C, fixed=True),
    "PixelFormat": Feature(0x10010, MONO16, (("Mono16", MONO16),), "Enumeration"),
    "PayloadSize": Feature(0x10014, fixed=True),
    "AcquisitionMode": Feature(0x10018, 1, (("Continuous", 1),), "Enumeration"),
    "AcquisitionStart": Feature(0x1001C, kind="Command"),
    "AcquisitionStop": Feature(0x10020, kind="Command"),
    "TriggerSelector": Feature(0x10024, 0, (("FrameStart", 0),), "Enumeration"),
    "TriggerMode": Feature(0x10028, 0, _OFF_ON, "Enumeration"),
    "TriggerSource": Feature(0x1002C, 1, (("Line0", 0), ("Software", 1)), "Enumeration"),
    "TriggerSoftware": Feature(0x10030, kind="Command"),
    "ExposureTime": Feature(0x10034, 1000, kind="Float", unit="us"),
    "GevSCPSPacketSize": Feature(int(Register.PACKET_SIZE), 1500),
}

_GROUPS = {
    "ImageFormatControl": ("SensorWidth", "SensorHeight", "Width", "Height", "PixelFormat"),
    "AcquisitionControl": (
        "AcquisitionMode", "AcquisitionStart", "AcquisitionStop", "TriggerSelector", "TriggerMode", "TriggerSource",
        "TriggerSoftware", "ExposureTime",
    ),
    "TransportLayerControl": ("PayloadSize", "GevSCPSPacketSize"),
}  # fmt: skip


def description() -> bytes:
    """The description of the camera, GenICam schema 1.1."""
    groups = "".join(
        f'<Category Name="{name}">{"".join(f"<pFeature>{one}</pFeature>" for one in members)}</Category>'
        for name, members in _GROUPS.items()
    )
    root = "".join(f"<pFeature>{name}</pFeature>" for name in _GROUPS)
    nodes = "".join(_node(name, feature) for name, feature in FEATURES.items())
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<RegisterDescription ModelName="EmulatedCamera" VendorName="Beambench" StandardNameSpace="GEV" '
        'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" '
        'SubMinorVersion="0" ToolTip="Emulated camera" ProductGuid="00000000-0000-0000-0000-000000000001" '
        'VersionGuid="00000000-0000-0000-0000-000000000001" xmlns="http://www.genicam.org/GenApi/Version_1_1">'
        f'<Category Name="Root" NameSpace="Standard">{root}</Category>{groups}{nodes}'
        '<Port Name="Device"/></RegisterDescription>\n'
    ).encode()


def _node(name: str, feature: Feature) -> str:
    mode = "RO" if feature.fixed else "WO" if feature.kind == "Command" else "RW"
    register = (
        f'<IntReg Name="{name}Register"><Address>{feature.address:#x}</Address><Length>4</Length>'
        f"<AccessMode>{mode}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable><Sign>Unsigned</Sign>"
        f"<Endianess>BigEndian</Endianess></IntReg>"
    )
    entries = "".join(
        f'<EnumEntry Name="{entry}" NameSpace="Standard"><Value>{value}</Value></EnumEntry>'
        for entry, value in feature.entries
    )
    target = f"<pValue>{name}Register</pValue>"
    head = f'<{feature.kind} Name="{name}" NameSpace="Standard">'
    tail = f"</{feature.kind}>"
    if feature.kind == "Command":
        return f"{head}{target}<CommandValue>1</CommandValue>{tail}{register}"
    if feature.kind == "Float":
        formulas = "<FormulaTo>FROM</FormulaTo><FormulaFrom>TO</FormulaFrom>"
        converter = f'<Converter Name="{name}Converter">{formulas}{target}</Converter>'
        limits = f"<Min>1</Min><Max>10000000</Max><Unit>{feature.unit}</Unit>"
        return f"{head}<pValue>{name}Converter</pValue>{limits}{tail}{converter}{register}"
    return f"{head}{entries}{target}{tail}{register}"


def bootstrap(host: str, serial: str, rows: int, cols: int, xml: bytes) -> dict[int, bytes]:
    """{address: content} of the camera's memory as it is switched on."""
    address = int.from_bytes(bytes(int(part) for part in host.split(".")), "big")
    words = {
        Register.VERSION: 0x00010002, Register.DEVICE_MODE: 0x80000001, Register.MAC_HIGH: 0x0200,
        Register.MAC_LOW: address, Register.CURRENT_IP: address, Register.INTERFACES: 1, Register.STREAMS: 1,
        # Packet resend, write memory, and several registers at a time.
        Register.CAPABILITY: 0x00000007, Register.HEARTBEAT_MS: 3000, Register.TICKS_LOW: 10**9,
        Register.PACKET_SIZE: 1500,
    }  # fmt: skip
    memory = {int(place): struct.pack(">I", value) for place, value in words.items()}
    values = {"SensorWidth": cols, "Width": cols, "SensorHeight": rows, "Height": rows, "PayloadSize": 2 * rows * cols}
    for name, feature in FEATURES.items():
        memory.setdefault(feature.address, struct.pack(">I", values.get(name, feature.value)))
    texts = ((Register.VENDOR, "Beambench", 32), (Register.MODEL, "EmulatedCamera", 32), (Register.FIRMWARE, "1", 32))
    for place, text, size in (*texts, (Register.SERIAL, serial, 16)):
        memory[int(place)] = text.encode().ljust(size, b"\0")
    url = f"Local:camera.xml;{XML_ADDRESS:x};{len(xml):x}"
    return memory | {int(Register.FIRST_URL): url.encode().ljust(512, b"\0"), XML_ADDRESS: xml}
