"""Packets of GigE Vision, images from packets, and the descriptions of cameras: of any bytes, too."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beambench.captures.drivers.gige import packets
from beambench.captures.drivers.gige.assembly import Assembly
from beambench.captures.drivers.gige.description import Features, NoFeature
from beambench.captures.drivers.gige.formula import FormulaError, evaluate

# ---------------------------------------------------------------- packets


def test_headers_have_the_bytes_of_the_standard() -> None:
    assert packets.command(packets.Command.READ_REGISTER, 7, b"\0\0\x0a\0") == bytes.fromhex(
        "4201008000040007 00000a00"
    )
    assert packets.acknowledge(packets.Command.READ_REGISTER, 7, b"abcd") == bytes.fromhex("0000008100040007") + b"abcd"
    assert packets.resend_request(3, 9, 2, 5) == bytes.fromhex(
        "4200004000 0c0003 00000009 00000002 00000005".replace(" ", "")
    )
    first = packets.leader(9, 2**32 + 5, packets.MONO16, 48, 40)
    assert first[:8] == bytes.fromhex("0000000901000000") and len(first) == 8 + 36
    assert packets.read_leader(packets.read_stream(first).body) == packets.Leader(2**32 + 5, packets.MONO16, 48, 40)
    assert packets.trailer(9, 4, 40) == bytes.fromhex("0000000902000004 00000001 00000028".replace(" ", ""))


def test_identifiers_wrap_from_65535_to_1() -> None:
    assert [packets.next_block(block) for block in (0, 1, 65534, 65535)] == [1, 2, 65535, 1]


def image_packets(block: int = 3, rows: int = 5, cols: int = 7, chunk: int = 16) -> tuple[Any, list[bytes]]:
    image = np.arange(rows * cols, dtype=np.uint16).reshape(rows, cols) * 257
    data = image.astype("<u2").tobytes()
    parts = [data[at : at + chunk] for at in range(0, len(data), chunk)]
    whole = [packets.leader(block, 1, packets.MONO16, cols, rows)]
    whole += [packets.payload(block, number, part) for number, part in enumerate(parts, 1)]
    return image, [*whole, packets.trailer(block, len(parts) + 1, rows)]


@given(st.data())
def test_any_order_and_any_loss_gives_the_image_or_says_what_is_missing(data: st.DataObject) -> None:
    image, sent = image_packets()
    lost = data.draw(st.sets(st.integers(0, len(sent) - 1)))
    assembly = Assembly(3, 5, 7, packets.MONO16, 16)
    for number in data.draw(st.permutations(range(len(sent)))):
        if number not in lost:
            assembly.add(packets.read_stream(sent[number]))
    told = [number for first, last in assembly.missing() for number in range(first, last + 1)]
    assert told == sorted(lost) and assembly.complete == (not lost)
    for number in lost:
        assembly.add(packets.read_stream(sent[number]))
    assert np.array_equal(assembly.image(), image)


@given(st.binary(max_size=80))
def test_any_bytes_are_a_packet_or_refused(raw: bytes) -> None:
    for reader in (packets.read_command, packets.read_acknowledge, packets.read_stream, packets.read_leader):
        with suppress(packets.PacketError):
            reader(raw)


@given(st.integers(0, 10), st.integers(0, 60), st.integers(0, 255))
def test_a_changed_byte_gives_another_packet_or_is_refused(number: int, place: int, value: int) -> None:
    _, sent = image_packets()
    raw = bytearray(sent[number % len(sent)])
    raw[place % len(raw)] = value
    assembly = Assembly(3, 5, 7, packets.MONO16, 16)
    with suppress(packets.PacketError):
        assembly.add(packets.read_stream(bytes(raw)))
    assert len(assembly._bytes) == 70  # no packet makes it take more memory


# ---------------------------------------------------------------- descriptions


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1+2*3", 7), ("(1+2)*3", 9), ("2**3**2", 512), ("-2**2", -4), ("10/4", 2.5), ("7%4", 3), ("TO*1e-3", 0.005),
        ("TO > 3 ? 1 : 2", 1), ("0x10 & 0x18", 16), ("1 << 4", 16), ("(TO = 5) && (TO <> 4)", 1),
    ],
)  # fmt: skip
def test_formulas(text: str, value: float) -> None:
    assert evaluate(text, {"TO": 5.0}) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["", "1/0", "__import__", "a.b", "1 1", "(" * 100, "9**9**9**9", "1<<9999999", "f(1)"])
def test_what_is_no_formula_is_refused(text: str) -> None:
    with pytest.raises(FormulaError):
        evaluate(text, {})


@given(st.text(alphabet="0123456789.+-*/%()<>=&|?: exTO", max_size=40))
def test_any_text_has_a_value_or_is_refused(text: str) -> None:
    with suppress(FormulaError):
        evaluate(text, {"TO": 2.0})


class Words(dict[int, bytes]):
    def read_memory(self, address: int, size: int) -> bytes:
        return self.get(address, bytes(size))[:size].ljust(size, b"\0")

    def write_memory(self, address: int, data: bytes) -> None:
        self[address] = data


def test_masked_registers_floats_converters_and_selectors() -> None:
    xml = b"""<RegisterDescription>
    <MaskedIntReg Name="Mask"><Address>0x10</Address><Length>4</Length><LSB>15</LSB><MSB>8</MSB>
    <Endianess>BigEndian</Endianess></MaskedIntReg>
    <FloatReg Name="Real"><Address>0x20</Address><Length>8</Length><Endianess>BigEndian</Endianess></FloatReg>
    <Converter Name="Ms"><FormulaTo>FROM*1000</FormulaTo><FormulaFrom>TO/1000</FormulaFrom><pValue>Real</pValue></Converter>
    <Integer Name="Selector"><Value>0</Value></Integer>
    <IntReg Name="Indexed"><Address>0x100</Address><pIndex Offset="0x20">Selector</pIndex><Length>2</Length><Sign>Signed</Sign>
    <Endianess>LittleEndian</Endianess></IntReg></RegisterDescription>"""
    memory = Words({0x10: bytes.fromhex("11223344")})
    features = Features(xml, memory)
    assert features.get("Mask") == 0x22  # bits 8 to 15 from the most significant one
    features.set("Mask", 0xAB)
    assert memory[0x10] == bytes.fromhex("11ab3344")
    features.set("Ms", 2.5)
    assert memory[0x20] == bytes.fromhex("40a3880000000000") and features.get("Ms") == 2.5
    features.set("Selector", 2)
    features.set("Indexed", -2)
    assert memory[0x140] == b"\xfe\xff" and features.get("Indexed") == -2


@pytest.mark.parametrize(
    "xml",
    [
        b"", b"<a", b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', b'<a><Integer Name="X"><pValue>X</pValue></Integer></a>',
        b'<a><IntReg Name="X"><Address>q</Address><Length>4</Length></IntReg></a>',
        b'<a><IntReg Name="X"><Address>1</Address><Length>99999999</Length></IntReg></a>', b'<a><Integer Name="X"/></a>',
    ],
)  # fmt: skip
def test_hostile_descriptions_are_refused(xml: bytes) -> None:
    with pytest.raises(NoFeature):
        Features(xml, Words()).get("X")
