"""Instruments that speak text over TCP: the DG645 against its emulator, which a package of its maker drives too; the DG535; an
oscilloscope's binary blocks."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beambench.captures.drivers.device import DeviceLost, DeviceTimeout, FrameDamaged
from beambench.captures.drivers.dg535 import Dg535
from beambench.captures.drivers.dg645 import Dg645
from beambench.captures.drivers.scope import Scope
from beambench.captures.drivers.scpi import ScpiLink, block_size
from beambench.generator.emulators.delay_generator import DelayGenerator
from beambench.generator.emulators.oscilloscope import Oscilloscope
from beambench.scenes.errors import InputError


@contextmanager
def generator() -> Iterator[tuple[DelayGenerator, list[float]]]:
    fired: list[float] = []
    emulated = DelayGenerator("127.0.0.1", 0, lambda one: fired.append(one.time_s(4) - one.time_s(2)))
    emulated.start()
    try:
        yield emulated, fired
    finally:
        emulated.close()


def place(address: tuple[str, int]) -> str:
    return f"{address[0]}:{address[1]}"


@contextmanager
def server(talk: Callable[[socket.socket], None]) -> Iterator[str]:
    """A server on a free port that does as `talk` says with each connection."""
    listening = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listening.accept()
                with connection, contextlib.suppress(OSError):
                    talk(connection)

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield place(listening.getsockname())
    finally:
        listening.close()


# ---------------------------------------------------------------- DG645


def test_delays_are_set_and_read_to_the_picosecond() -> None:
    with generator() as (emulated, fired):
        device = Dg645(place(emulated.address))
        assert device.open() == {
            "vendor": "Stanford Research Systems", "model": "DG645", "serial": "001234", "firmware": "ver1.10.000E",
        }  # fmt: skip
        for delay_s in (26.5e-9, 31.305e-9, 1.000000000005e-3, 1999.0):
            told = device.configure({"delay_s": delay_s, "laser_on": True, "pulses": 100})
            assert told["laser_on"] is True and told["pulses"] == 100 == emulated.pulses
            assert abs(told["delay_s"] - delay_s) < 0.5e-12 + 1e-15 * delay_s
            device.fire()
        device.configure({"laser_on": False, "pulses": 1})
        assert emulated.level_v(1) == 0.5 and emulated.pulses == 1
        end = time.monotonic() + 5
        while len(fired) < 4 and time.monotonic() < end:
            time.sleep(0.01)
        assert fired == pytest.approx([26.5e-9, 31.305e-9, 1.000000000005e-3, 1999.0], abs=1e-12)
        device.close()


def test_what_it_refuses_is_said_with_its_error() -> None:
    with generator() as (emulated, _):
        device = Dg645(place(emulated.address))
        device.open()
        with pytest.raises(InputError, match="error 10"):
            device.configure({"delay_s": 3000.0})
        with pytest.raises(InputError, match="error 10"):
            device.configure({"delay_s": -1e-9})  # before T0
        with pytest.raises(InputError, match="no such setting"):
            device.configure({"delay_ns": 3.0})
        assert device.configure({"delay_s": 1e-9})["delay_s"] == 1e-9  # the error is not told twice
        device.close()
    for wrong in ({"laser": "Z"}, {"laser_output": "A"}):
        with pytest.raises(InputError, match="no such channel"):
            Dg645("127.0.0.1", **wrong)
    with pytest.raises(DeviceLost):
        Dg645("localhost:1").open()
    with generator() as (emulated, _), pytest.raises(InputError, match="Another instrument"):
        Dg645(place(emulated.address), serial="999").open()


def test_settings_take_less_than_nagles_forty_milliseconds() -> None:
    with generator() as (emulated, _):
        device = Dg645(place(emulated.address))
        device.open()
        spent = []
        for number in range(30):
            begun = time.perf_counter()
            device.configure({"delay_s": number * 1e-9, "laser_on": True, "pulses": 10})
            spent.append(time.perf_counter() - begun)
        assert (
            np.median(spent) < 0.02
        )  # .0003 s on an idle machine; 0.088 with Nagle's algorithm and delayed acknowledges
        device.close()


def test_a_package_of_its_maker_drives_the_emulator() -> None:
    maker = pytest.importorskip("srsinst.dg645")
    with generator() as (emulated, fired):
        instrument = maker.DG645("tcpip", *emulated.address)
        try:
            instrument.delays.delay["C"]["A"] = 30.005e-9
            instrument.outputs.amplitude["AB"] = 3.5
            instrument.send("TSRC 5")
            instrument.send("*TRG")
            assert "DG645" in instrument.query_text("*IDN?")
            assert float(instrument.query_text("DLAY?4").split(",")[1]) == pytest.approx(30.005e-9, abs=1e-15)
            assert emulated.level_v(1) == 3.5
            assert fired == pytest.approx([30.005e-9], abs=1e-15)
            assert int(instrument.query_text("LERR?")) == 0
        finally:
            instrument.disconnect()


# ---------------------------------------------------------------- answers that come late, wrong or never


def test_a_late_answer_is_not_that_of_the_next_question() -> None:
    def slow(connection: socket.socket) -> None:
        for question in connection.makefile("rb"):
            if question == b"FIRST?\n":
                time.sleep(0.4)
            connection.sendall(question.replace(b"?", b""))

    with server(slow) as address:
        link = ScpiLink(address, timeout_s=0.2)
        with pytest.raises(DeviceTimeout):
            link.ask("FIRST?")
        time.sleep(0.4)
        assert link.ask("SECOND?") == ["SECOND"]
        link.close()


@pytest.mark.parametrize(
    "answer", [b"", b"what\r\n" * 9, b"\xff\xfe\n" * 9, b"2,nan\n0\n0\n0\n", b"7,+0.1\n0\n0\n0\n", b"x" * 9999]
)
def test_wrong_answers_are_a_lost_device(answer: bytes) -> None:
    def talk(connection: socket.socket) -> None:
        connection.recv(999)
        connection.sendall(b"Stanford Research Systems,DG645,s/n1,v\r\n")
        connection.recv(999)
        connection.sendall(answer)

    with server(talk) as address:
        device = Dg645(address)
        device.open()
        with pytest.raises((DeviceLost, DeviceTimeout, InputError)):
            device.configure({"delay_s": 1e-9})
        device.close()


@settings(max_examples=20)
@given(st.lists(st.text(max_size=40), max_size=8))
def test_the_emulator_takes_any_text(texts: list[str]) -> None:
    with generator() as (emulated, _):
        for text in texts:
            emulated.obey(text)
        assert emulated.obey("*IDN?") is not None


# ---------------------------------------------------------------- DG535


def test_dg535_speaks_as_its_manual_says() -> None:
    said: list[str] = []
    state = {"DT 5": "2,+0.000000000000", "OA 4": "+2.50", "ES": "0"}

    def talk(connection: socket.socket) -> None:
        question = ""
        for raw in connection.makefile("rb"):
            line = raw.decode().strip()
            said.append(line)
            if line == "++read eoi":
                connection.sendall((state[question] + "\r\n").encode())
            elif line.startswith("DT 5,2,"):
                state["DT 5"] = f"2,{float(line.split(',')[2]):+.12f}"
            elif line.startswith("OA 4,"):
                state["OA 4"] = f"{float(line.split(',')[1]):+.2f}"
            question = line

    with server(talk) as address:
        device = Dg535(address, gpib=12)
        assert device.open()["model"] == "DG535"
        assert device.configure({"delay_s": 31.305e-9, "laser_on": False}) == {"delay_s": 31.305e-9, "laser_on": False}
        device.fire()
        state["ES"] = "4"
        with pytest.raises(InputError, match="error 4"):
            device.configure({"pulses": 1})
        with pytest.raises(InputError, match="no such setting"):
            device.configure({"pulses": 2})
        device.close()
    assert said[:4] == ["++mode 1", "++addr 12", "++auto 0", "++eoi 1"] and "TM 2" in said and "SS" in said
    assert "DT 5,2,0.000000031305" in said


# ---------------------------------------------------------------- oscilloscope


def staircase(shot: int) -> np.ndarray:
    """Every 16-bit number once, so that each byte of the block takes every value, 0x0A too."""
    return np.arange(-32768, 32768) * 1e-3 + 0.0 * shot


@pytest.mark.parametrize("by_visa", [False, True])
def test_blocks_that_hold_line_feeds_are_whole(by_visa: bool) -> None:
    if by_visa:
        pytest.importorskip("pyvisa_py")
    emulated = Oscilloscope("127.0.0.1", 0, staircase, 1e-10, 1e-3)
    emulated.start()
    host, port = emulated.address
    scope = Scope(f"TCPIP::{host}::{port}::SOCKET" if by_visa else f"{host}:{port}")
    assert scope.open()["model"] == "EMULATED-SCOPE"
    assert scope.configure({}) == {"step_s": 1e-10, "start_s": 0.0, "volts": 1e-3}
    for _ in range(2):
        scope.arm()
        reading = scope.read(10.0)
        assert np.array_equal(reading.data, np.arange(-32768, 32768) * 1e-3)
    scope.close()


@given(st.binary(max_size=24))
def test_any_head_is_a_block_or_not(raw: bytes) -> None:
    found = block_size(raw)
    if found is not None and found != (0, 0):
        start, length = found
        assert raw[:1] == b"#" and raw[2:start] == str(length).encode().rjust(start - 2, b"0")


@pytest.mark.parametrize("answer", [b"volts\n", b"#0\n", b"#9999999999", b"#3abc", b"#15ab"])
def test_what_is_no_block_is_refused(answer: bytes) -> None:
    def talk(connection: socket.socket) -> None:
        connection.recv(99)
        connection.sendall(answer)
        time.sleep(0.5)

    with server(talk) as address:
        link = ScpiLink(address)
        with pytest.raises((FrameDamaged, DeviceTimeout, DeviceLost)):
            link.block("CURVE?", 0.2)
        link.close()
