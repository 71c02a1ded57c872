"""GigE Vision in plain Python: our client and server against each other and against those of two other projects (Aravis,
viva-genicam)."""

from __future__ import annotations

import importlib.util
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beambench.captures.drivers.device import DeviceLost, DeviceTimeout, FrameDamaged
from beambench.captures.drivers.gige import packets
from beambench.captures.drivers.gige.camera import GigeCamera
from beambench.captures.drivers.gige.control import Control, RegisterRefused
from beambench.captures.drivers.listing import DRIVERS
from beambench.generator.emulators.bench import Faults
from beambench.generator.emulators.camera import EmulatedCamera
from beambench.scenes.errors import InputError

from ._emulated import SHAPE, Ramp, bench, free_host

ON = {"TriggerMode": "On", "TriggerSource": "Software"}


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
