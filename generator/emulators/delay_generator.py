"""An emulated SRS DG645 on TCP: the commands that a gated camera needs, with the instrument's own checks and error codes.

Source: Stanford Research Systems, DG645 user manual, rev. 1.2, chapter 3 (remote programming).
"""

from __future__ import annotations

import contextlib
import re
import socket
import threading
from collections.abc import Callable

__all__ = ["DelayGenerator"]

_RESOLUTION_S = 5e-12
_LONGEST_S = 2000.0
_LONGEST_LINE = 256
#: Numbers of the errors that `LERR?` tells.
_ILLEGAL_VALUE, _ILLEGAL_MODE, _SYNTAX, _ILLEGAL_COMMAND, _MISSING = 10, 11, 110, 111, 114


class DelayGenerator:
    """Delays of ten channels (T0, T1, A … H), levels of five outputs (T0, AB, CD, EF, GH), bursts, and the trigger.

    `fire` is called at each trigger in single-shot mode.
    """

    def __init__(self, host: str, port: int, fire: Callable[[DelayGenerator], None]) -> None:
        self._fire = fire
        self._lock = threading.Lock()
        self.reset()
        self._connections: list[socket.socket] = []
        self._server = socket.create_server((host, port))

    def reset(self) -> None:
        """As after `*RST`: no delays, outputs of 2.5 V, internal trigger, no burst."""
        self._links = dict.fromkeys(range(2, 10), (0, 0.0))
        self._levels = dict.fromkeys(range(5), 2.5)
        self._numbers = {"TSRC": 0, "BURM": 0, "BURC": 5}
        self._times = {"BURP": 1e-4, "BURD": 0.0}
        self._error = 0

    @property
    def address(self) -> tuple[str, int]:
        """(host, port)."""
        host, port = self._server.getsockname()[:2]
        return host, port

    def time_s(self, channel: int) -> float:
        """Time of a channel after T0, s."""
        total = 0.0
        while channel >= 2:
            channel, delay = self._links[channel]
            total += delay
        return total

    def level_v(self, output: int) -> float:
        """Amplitude of an output (1 is AB), V."""
        return self._levels[output]

    @property
    def pulses(self) -> int:
        """Pulses of one trigger."""
        return self._numbers["BURC"] if self._numbers["BURM"] else 1

    def start(self) -> None:
        """Serve in threads of their own."""
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Stop serving, and end all connections."""
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for connection in self._connections:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self._connections.append(connection)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection: socket.socket) -> None:
        rest = b""
        with connection:
            while True:
                try:
                    data = connection.recv(4096)
                except OSError:
                    return
                if not data:
                    return
                *lines, rest = re.split(rb"[\r\n]", rest + data)
                rest = rest[-_LONGEST_LINE:]
                for line in filter(None, lines):
                    answers = [
                        self.obey(one.strip()) for one in line.decode("ascii", "replace").split(";") if one.strip()
                    ]
                    told = "".join(f"{answer}\r\n" for answer in answers if answer is not None)
                    try:
                        connection.sendall(told.encode())
                    except OSError:
                        return

    def obey(self, command: str) -> str | None:
        """Carry out one command; the answer of a query, None where there is none."""
        found = re.fullmatch(r"(\*?[A-Za-z]{3,4})(\?)?\s*(.*)", command)
        if not found:
            return self._fail(_SYNTAX)
        word, query, rest = (
            found[1].upper(),
            bool(found[2]),
            [part.strip() for part in found[3].split(",") if part.strip()],
        )
        act = _COMMANDS.get(word)
        if act is None:
            return self._fail(_ILLEGAL_COMMAND)
        try:
            if word == "*TRG" and not query:  # outside the lock: a shot takes its time, and sees the settings
                return act(self, False, rest)
            with self._lock:
                return act(self, query, rest)
        except (ValueError, KeyError):
            return self._fail(_ILLEGAL_VALUE)
        except IndexError:
            return self._fail(_MISSING)

    def _fail(self, number: int) -> str | None:
        """Keep the number of an error until it is asked for; a command that fails has no answer."""
        self._error = number
        return None

    def _identity(self, query: bool, rest: list[str]) -> str | None:
        return "Stanford Research Systems,DG645,s/n001234,ver1.10.000E"

    def _trigger(self, query: bool, rest: list[str]) -> str | None:
        if self._numbers["TSRC"] != 5:
            return self._fail(_ILLEGAL_MODE)
        self._fire(self)
        return None

    def _last_error(self, query: bool, rest: list[str]) -> str:
        told, self._error = self._error, 0
        return str(told)

    def _delay(self, query: bool, rest: list[str]) -> str | None:
        channel = int(rest[0])
        if query:
            reference, delay = self._links[channel]
            return f"{reference},{delay:+.12f}"
        reference, delay = int(rest[1]), round(float(rest[2]) / _RESOLUTION_S) * _RESOLUTION_S
        if channel not in self._links or not 0 <= reference < 10 or reference == channel:
            raise ValueError
        before = self._links[channel]
        self._links[channel] = (reference, delay)
        if self._is_circle(channel) or not 0 <= self.time_s(channel) <= _LONGEST_S:
            self._links[channel] = before
            raise ValueError
        return None

    def _is_circle(self, channel: int) -> bool:
        start, steps = channel, 0
        while channel >= 2 and steps < 10:
            channel, steps = self._links[channel][0], steps + 1
            if channel == start:
                return True
        return steps >= 10

    def _level(self, query: bool, rest: list[str]) -> str | None:
        output = int(rest[0])
        if query:
            return f"{self._levels[output]:+.2f}"
        level = float(rest[1])
        if output not in self._levels or not 0.5 <= level <= 5.0:
            raise ValueError
        self._levels[output] = level
        return None


def _numbered(name: str, low: int, high: int) -> Callable[[DelayGenerator, bool, list[str]], str | None]:
    def act(generator: DelayGenerator, query: bool, rest: list[str]) -> str | None:
        if query:
            return str(generator._numbers[name])
        value = int(rest[0])
        if not low <= value <= high:
            raise ValueError
        generator._numbers[name] = value
        return None

    return act


def _timed(name: str, low: float, high: float) -> Callable[[DelayGenerator, bool, list[str]], str | None]:
    def act(generator: DelayGenerator, query: bool, rest: list[str]) -> str | None:
        if query:
            return f"{generator._times[name]:+.12f}"
        value = float(rest[0])
        if not low <= value <= high:
            raise ValueError
        generator._times[name] = value
        return None

    return act


def _forget(generator: DelayGenerator, query: bool, rest: list[str]) -> None:
    generator._error = 0


def _again(generator: DelayGenerator, query: bool, rest: list[str]) -> None:
    generator.reset()


def _done(generator: DelayGenerator, query: bool, rest: list[str]) -> str | None:
    return "1" if query else None


_COMMANDS: dict[str, Callable[[DelayGenerator, bool, list[str]], str | None]] = {
    "*IDN": DelayGenerator._identity,
    "*TRG": DelayGenerator._trigger,
    "*CLS": _forget,
    "*RST": _again,
    "*OPC": _done,
    "LERR": DelayGenerator._last_error,
    "DLAY": DelayGenerator._delay,
    "LAMP": DelayGenerator._level,
    "TSRC": _numbered("TSRC", 0, 6),
    "BURM": _numbered("BURM", 0, 1),
    "BURC": _numbered("BURC", 1, 2**32 - 1),
    "BURP": _timed("BURP", 100e-9, 42.9),
    "BURD": _timed("BURD", 0.0, _LONGEST_S),
}
