"""GigE Vision in plain Python: packets, images from packets, and our client and server against each other and against those of
two other projects (Aravis, viva-genicam)."""

from __future__ import annotations

import importlib.util
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beambench.captures.drivers.device import DeviceLost, DeviceTimeout, FrameDamaged
from beambench.captures.drivers.gige import packets
from beambench.captures.drivers.gige.assembly import Assembly
from beambench.captures.drivers.gige.camera import GigeCamera
from beambench.captures.drivers.gige.control import Control, RegisterRefused
from beambench.captures.drivers.gige.description import Features, NoFeature
from beambench.captures.drivers.gige.formula import FormulaError, evaluate
from beambench.captures.drivers.listing import DRIVERS
from beambench.generator.emulators.bench import Faults
from beambench.generator.emulators.camera import EmulatedCamera
from beambench.scenes.errors import InputError

from ._emulated import SHAPE, Ramp, bench, free_host

ON = {"TriggerMode": "On", "TriggerSource": "Software"}


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


# ---------------------------------------------------------------- our client and our server


@contextmanager
def camera_at(host: str, **options: Any) -> Iterator[GigeCamera]:
    camera = GigeCamera(host, **options)
    try:
        yield camera
    finally:
        camera.close()


def test_lost_packets_are_asked_for_again_and_images_are_exact() -> None:
    with bench(Faults(loss=0.2), seed=3) as (rig, _), camera_at(rig.camera.address[0], packet_bytes=200) as camera:
        told = camera.open()
        assert told == {"vendor": "Beambench", "model": "EmulatedCamera", "serial": "EMU0001", "firmware": "1"}
        assert camera.configure(ON | {"exposure_s": 2e-3})["exposure_s"] == pytest.approx(2e-3)
        again = 0
        for shot in range(1, 31):
            camera.arm()
            camera.fire()
            reading = camera.read(5.0)
            again += reading.meta["packets_resent"]
            assert reading.index == shot
            expected = Ramp().frame(0.0, pulses=1, exposure_s=1.0, laser_on=False, shot=shot)
            expected[-1, -1] = 0
            assert np.array_equal(reading.data, expected)
        assert again > 30, "a fifth of some 300 packets was lost, and hardly any asked for: losses are not planted"


def test_identifiers_are_read_over_the_wrap() -> None:
    with bench() as (rig, _), camera_at(rig.camera.address[0]) as camera:
        rig.camera._block = 65533
        camera.open()
        camera.configure(ON)
        found = []
        for _ in range(4):
            camera.arm()
            camera.fire()
            found.append(camera.read(5.0).index)
        assert found == [65534, 65535, 1, 2]


def test_late_packets_of_an_earlier_image_are_no_news() -> None:
    with bench() as (rig, _sight), camera_at(rig.camera.address[0]) as camera:
        camera.open()
        camera.configure(ON)
        camera.arm()
        camera.fire()
        first = camera.read(5.0)
        late = rig.camera._kept[first.index][1]
        camera.fire()
        time.sleep(0.2)
        rig.camera._put(late)
        assert camera.read(5.0).index == first.index + 1
        rig.camera._put(late)  # now alone
        with pytest.raises(DeviceTimeout):
            camera.read(0.2)


def test_an_image_that_stays_incomplete_is_damaged_and_silence_is_a_timeout() -> None:
    with bench() as (rig, _), camera_at(rig.camera.address[0]) as camera:
        camera.open()
        camera.configure(ON)
        with pytest.raises(DeviceTimeout):
            camera.read(0.1)
        rig.camera._put(packets.leader(5, 1, packets.MONO16, SHAPE[1], SHAPE[0]))
        with pytest.raises(FrameDamaged, match="no longer has packet"):  # block 5 was never sent
            rig.camera._kept[5] = []
            camera.read(2.0)
        rig.camera._put(packets.leader(6, 1, packets.MONO16, 10**6, 10**6))
        with pytest.raises(FrameDamaged, match="1000000"):
            camera.read(2.0)


def test_one_client_controls_and_a_dead_one_loses_it() -> None:
    with bench() as (rig, _):
        host = rig.camera.address[0]
        first = Control(host)
        first.write_register(packets.Register.CONTROL, 2)
        first.write_register(packets.Register.HEARTBEAT_MS, 600)
        second = Control(host)
        with pytest.raises(RegisterRefused, match="access denied"):
            second.write_register(packets.Register.CONTROL, 2)
        first.close()  # no heartbeat any more
        with camera_at(host) as camera:
            camera.open()  # waits for it
            with pytest.raises(RegisterRefused):
                second.write_register(packets.Register.STREAM_PORT, 1)
        second.close()


def test_wrong_serial_no_camera_and_unknown_features() -> None:
    with bench() as (rig, _):
        with (
            camera_at(rig.camera.address[0], serial="OTHER") as camera,
            pytest.raises(InputError, match="Another camera"),
        ):
            camera.open()
        with camera_at(rig.camera.address[0]) as camera:
            camera.open()
            for wrong in ({"NoSuch": 1}, {"TriggerMode": "Perhaps"}, {"TriggerMode": "On", "Width": 9}):
                with pytest.raises(InputError, match=r"NoSuch|Perhaps|write protect"):
                    camera.configure(wrong)
    with camera_at(free_host()) as camera, pytest.raises(DeviceLost, match="no answer"):
        camera.open()


@settings(max_examples=20)
@given(st.lists(st.binary(max_size=60), max_size=5))
def test_the_server_answers_any_bytes_or_ignores_them(raw: list[bytes]) -> None:
    with bench() as (rig, _), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for packet in raw:
            stranger.sendto(packet, rig.camera.address)
        control = Control(rig.camera.address[0])
        assert control.read_register(packets.Register.VERSION) == 0x00010002
        control.close()


# ---------------------------------------------------------------- other people's clients and servers


def _port_is_free(host: str) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        try:
            trial.bind((host, packets.GVCP_PORT))
        except OSError:
            return False
    return True


@contextmanager
def aravis_server() -> Iterator[str]:
    """Aravis' fake camera; it knows addresses of interfaces only."""
    program = shutil.which("arv-fake-gv-camera-0.8")
    if program is None:
        pytest.skip("arv-fake-gv-camera-0.8 is not installed (apt install aravis-tools-cli)")
    if not _port_is_free("127.0.0.1"):
        pytest.skip("another camera is at 127.0.0.1")
    process = subprocess.Popen(
        [program, "-i", "127.0.0.1", "-s", "GV02"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + 10.0
        while _port_is_free("127.0.0.1") and time.monotonic() < end:
            time.sleep(0.05)
        yield "127.0.0.1"
    finally:
        process.kill()
        process.wait()


def clients() -> list[str]:
    return [name for name in ("gige", "aravis") if DRIVERS[name].there]


def client_of(name: str, host: str) -> Any:
    if name == "aravis":
        if not DRIVERS["aravis"].there:
            pytest.skip("Aravis' bindings are not installed: beambench drivers list")
        from beambench.captures.drivers.aravis import AravisCamera

        return AravisCamera(host)
    return GigeCamera(host)


@pytest.mark.parametrize("name", ["gige", "aravis"])
def test_both_clients_read_our_server(name: str) -> None:
    with bench(Faults(loss=0.01), seed=5) as (rig, _):
        camera = client_of(name, rig.camera.address[0])
        assert camera.open()["model"] == "EmulatedCamera"
        assert camera.configure(ON | {"exposure_s": 1e-3})["exposure_s"] == pytest.approx(1e-3)
        for shot in range(1, 11):
            camera.arm()
            camera.fire()
            reading = camera.read(5.0)
            assert reading.index == shot and reading.data.dtype == np.uint16
            assert np.array_equal(reading.data[0], 7 * shot + np.arange(SHAPE[1]))
        camera.close()


@pytest.mark.parametrize("name", ["gige", "aravis"])
def test_both_clients_read_the_server_of_aravis(name: str) -> None:
    wanted = {"Width": 64, "Height": 48, "PixelFormat": "Mono8", "TriggerSelector": "FrameStart"} | ON
    with aravis_server() as host:
        camera = client_of(name, host)
        assert camera.open()["serial"] == "GV02"
        told = camera.configure(wanted | {"exposure_s": 1e-3, "AcquisitionFrameRate": 25.0})
        assert (told["rows"], told["cols"], told["PixelFormat"]) == (48, 64, "Mono8")
        last = None
        for _ in range(5):
            camera.arm()
            camera.fire()
            reading = camera.read(5.0)
            assert reading.data.shape == (48, 64)
            assert last is None or reading.index == packets.next_block(last)
            last = reading.index
        camera.close()


def test_our_client_reads_the_server_of_viva_with_packets_that_it_drops() -> None:
    testing = pytest.importorskip("viva_genicam.testing")
    host = free_host()
    fake = testing.FakeGigeCamera(64, 48, 20, bind_ip=host, pixel_format="Mono16", drop_packets=[(2, 1), (3, 2)])
    with fake, camera_at(host) as camera:
        camera.open()
        camera.configure({"TriggerSelector": "FrameStart"} | ON)
        again = []
        for _ in range(4):
            camera.arm()
            camera.fire()
            reading = camera.read(5.0)
            assert reading.data.shape == (48, 64) and reading.data.dtype == np.uint16
            again.append(reading.meta["packets_resent"])
        assert again[1] >= 1 and again[2] >= 1 and again[0] == again[3] == 0


def test_the_client_of_viva_reads_our_server() -> None:
    viva = pytest.importorskip("viva_genicam")
    if not _port_is_free("0.0.0.0"):
        pytest.skip("another camera is at 127.0.0.1")
    sight, holder = Ramp(), []
    camera = EmulatedCamera(
        "127.0.0.1", *SHAPE, serial="EMU0001", draw=np.random.default_rng(1), loss=0.01, listen="",
        expose=lambda: holder[0].send(sight.frame(0, pulses=1, exposure_s=1, laser_on=True, shot=len(sight.seen) + 1)),
    )  # fmt: skip
    holder.append(camera)
    camera.start()
    try:
        (found,) = (one for one in viva.discover(timeout_ms=1500) if one.model == "EmulatedCamera")
        client = viva.connect_gige(found)
        assert client.skipped() == []  # it reads every node of our description
        client.set_enum("TriggerMode", "On")
        client.set_enum("TriggerSource", "Software")
        with client.stream() as frames:
            for shot in range(1, 6):
                client.execute("TriggerSoftware", wait=False)
                frame = frames.next_frame(5000)
                assert frame.is_complete and frame.block_id == shot
                assert np.array_equal(frame.to_numpy()[0], 7 * shot + np.arange(SHAPE[1]))
        client.close()
    finally:
        camera.close()


def test_a_driver_that_is_not_there_says_how_to_get_it() -> None:
    assert importlib.util.find_spec("pylablib") is None or DRIVERS["andor"].there
    assert {"gige", "dg645", "replay"} <= {name for name, one in DRIVERS.items() if one.there}
    assert all(one.how for one in DRIVERS.values() if one.needs)
