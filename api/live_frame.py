"""The last frame of a recording in the terminal, as sixels where it draws them or as half blocks, and the time that is left."""

from __future__ import annotations

import contextlib
import os
import re
import select
import sys
import time
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from .coloured import half_blocks
from .scenes.plain_text import plain_text

__all__ = ["LiveFrame", "blocks", "progress_line", "sixel"]

_ROWS, _COLS = 16, 64
_EVERY_S = 0.2
_LEVELS = 24  # the greys of a terminal of 256 colours
_FIRST_GREY = 232


class LiveFrame:
    """Shows (shots done, in all, words, frame); a context manager. `quiet` shows nothing."""

    def __init__(self, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._quiet = quiet
        self._live = not quiet and self._stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"
        self._sixel = self._live and _draws_sixels(self._stream)
        self._begun = time.monotonic()
        self._first: int | None = None
        self._last = -1e9
        self._height = 0

    def __enter__(self) -> LiveFrame:
        return self

    def __exit__(self, *error: object) -> None:
        self._stream.flush()

    def __call__(self, done: int, total: int, text: str, frame: NDArray[Any] | None) -> None:
        """One shot more."""
        now = time.monotonic()
        if self._first is None:
            self._first, self._begun = done, now
        wait = _EVERY_S if self._live else 1.0
        if self._quiet or (done < total and now - self._last < wait):
            return
        self._last = now
        line = progress_line(done, total, done - self._first, now - self._begun, text)
        if not self._live:
            print(plain_text(line), file=self._stream, flush=True)
            return
        picture = [] if frame is None else self._picture(frame)
        up = f"\x1b[{self._height}F" if self._height else ""
        body = "".join(f"\x1b[2K{row}\n" for row in [*picture, plain_text(line)])
        self._stream.write(up + body)
        self._stream.flush()
        self._height = (_ROWS if self._sixel and picture else len(picture)) + 1

    def _picture(self, frame: NDArray[Any]) -> list[str]:
        image = frame[None, :] if frame.ndim == 1 else frame
        if not self._sixel:
            return blocks(image, _ROWS, _COLS)
        # Room first, then back up: at the bottom of the screen a picture would scroll away what is above it.
        room = _ROWS - 1
        return ["\n" * room + f"\x1b[{room}A\x1b7" + sixel(image) + f"\x1b8\x1b[{room}B"]


def progress_line(done: int, total: int, taken: int, spent_s: float, text: str) -> str:
    """ "12/124 scan 3/44, 5 s left": the time left follows from the shots `taken` in `spent_s`."""
    if done >= total:
        return f"record {done}/{total} {text}"
    left = f", {spent_s / taken * (total - done):.0f} s left" if taken > 0 else ""
    return f"record {done}/{total} {text}{left}"


def blocks(image: NDArray[Any], rows: int, cols: int) -> list[str]:
    """An image (row, col) in at most `rows` × `cols` characters: the upper half of each shows one row of it, the lower the next."""
    grey = _levels(_sampled(image, 2 * rows, cols), _LEVELS - 1)
    return half_blocks([[f"5;{_FIRST_GREY + level}" for level in line] for line in grey])


def sixel(image: NDArray[Any], rows: int = 192, cols: int = 384) -> str:
    """An image (row, col) as sixels (DEC VT340): 16 greys, at most `rows` × `cols` dots, small images enlarged by whole factors."""
    sampled = _sampled(image, rows, cols)
    factor = max(1, min(rows // sampled.shape[0], cols // sampled.shape[1]))
    grey = np.kron(_levels(sampled, 15), np.ones((factor, factor), int))
    parts = ["\x1bPq"] + [f"#{level};2;{(value := level * 100 // 15)};{value};{value}" for level in range(16)]
    for top in range(0, len(grey), 6):
        band = grey[top : top + 6]
        bits = (1 << np.arange(len(band)))[:, None]
        for level in np.unique(band):
            columns = ((band == level) * bits).sum(axis=0)
            parts.append(f"#{level}" + "".join(chr(63 + int(value)) for value in columns) + "$")
        parts.append("-")
    return "".join(parts) + "\x1b\\"


def _sampled(image: NDArray[Any], rows: int, cols: int) -> NDArray[np.float64]:
    step = max(1, -(-image.shape[0] // rows), -(-image.shape[1] // cols))
    return np.asarray(image[::step, ::step], np.float64)


def _levels(image: NDArray[np.float64], top: int) -> NDArray[np.int64]:
    low, high = np.percentile(image, (1, 99.5))
    return np.asarray(np.clip(np.rint((image - low) / max(high - low, 1e-9) * top), 0, top), np.int64)


def _draws_sixels(stream: TextIO) -> bool:
    """Whether the terminal says that it draws sixels: its answer to the question for its attributes holds a 4."""
    if not sys.stdin.isatty():
        return False
    with contextlib.suppress(ImportError, OSError, ValueError):
        import termios
        import tty

        descriptor = sys.stdin.fileno()
        before = termios.tcgetattr(descriptor)
        try:
            tty.setcbreak(descriptor)
            stream.write("\x1b[c")
            stream.flush()
            answer = b""
            while not answer.endswith(b"c") and select.select([descriptor], [], [], 0.2)[0]:
                answer += os.read(descriptor, 64)
        finally:
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        found = re.search(rb"\x1b\[\?([0-9;]+)c", answer)
        return found is not None and b"4" in found[1].split(b";")
    return False
