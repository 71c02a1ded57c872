"""An emulated oscilloscope on TCP: IEEE 488.2 binary blocks of 16-bit samples, whose bytes hold every value, line feeds too."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["Oscilloscope"]


class Oscilloscope:
    """Answers *IDN?, the waveform's scale, and `CURVe?` with a block of what `trace` gives [V] (sample).

    Main arguments:
        trace: the signal of shot number n, V; `step_s`: distance of its samples; `volts`: volts of one digit.
    """

    def __init__(
        self, host: str, port: int, trace: Callable[[int], NDArray[np.float64]], step_s: float, volts: float
    ) -> None:
        self._trace, self._step_s, self._volts = trace, step_s, volts
        self._shots = 0
        self._server = socket.create_server((host, port))

    @property
    def address(self) -> tuple[str, int]:
        """(host, port)."""
        host, port = self._server.getsockname()[:2]
        return host, port

    def start(self) -> None:
        """Serve in threads of their own."""
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with connection, connection.makefile("rb") as lines:
            for line in lines:
                for command in line.decode("ascii", "replace").strip().split(";"):
                    if (answer := self._obey(command.strip())) is not None:
                        connection.sendall(answer + b"\n")

    def _obey(self, command: str) -> bytes | None:
        word = command.upper()
        if word in ("*TRG", ":ACQUIRE:STATE RUN", "ACQUIRE:STATE RUN"):
            self._shots += 1
            return None
        fixed = {
            "*IDN?": "BEAMBENCH,EMULATED-SCOPE,0,1", "*OPC?": "1", "WFMOUTPRE:XINCR?": f"{self._step_s:.9e}",
            "WFMOUTPRE:XZERO?": "0.0", "WFMOUTPRE:YMULT?": f"{self._volts:.9e}", "WFMOUTPRE:YOFF?": "0.0",
            "WFMOUTPRE:YZERO?": "0.0", "ACQUIRE:NUMACQ?": str(self._shots), "HORIZONTAL:RECORDLENGTH?": "0",
        }  # fmt: skip
        if word == "CURVE?":
            digits = np.clip(np.rint(self._trace(self._shots) / self._volts), -32768, 32767).astype(">i2").tobytes()
            length = str(len(digits))
            return f"#{len(length)}{length}".encode() + digits
        return fixed[word].encode() if word in fixed else None
