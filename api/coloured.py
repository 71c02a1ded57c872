"""Panels of pictures in the terminal: half blocks in 24-bit colour, or in grey where there is no colour."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .scenes.plain_text import plain_text

if TYPE_CHECKING:
    from .benchmarks.looks.blocks import Colours
    from .benchmarks.looks.panel import Curves, Image

__all__ = ["colour_blocks", "drawn", "grey_blocks", "half_blocks", "has_colour", "told"]

#: A panel takes at most so many characters; two rows of an image are one row of characters.
_ROWS, _COLS, _GAP = 20, 48, 2
#: Shades of text without colour, from dark to light (Unicode block elements).
_SHADES = " ░▒▓█"


def has_colour() -> bool:
    """Whether the terminal shows colours; NO_COLOR says no (no-color.org), and so does a dumb one."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM", "xterm") != "dumb"


def drawn(panels: Sequence[Image | Curves]) -> Iterator[str]:
    """The lines of all panels, as many beside each other as fit in the terminal's width."""
    from .benchmarks.looks.blocks import samples_of

    width = shutil.get_terminal_size((100, 40)).columns
    paint = colour_blocks if has_colour() else grey_blocks
    row: list[tuple[str, list[str], int]] = []
    for panel in panels:
        samples = samples_of(panel, 2 * _ROWS, min(_COLS, width))
        if row and sum(one[2] + _GAP for one in row) + samples.shape[1] > width:
            yield from _beside(row)
            row = []
        row.append((told(panel), paint(samples), samples.shape[1]))
    yield from _beside(row)


def _beside(row: list[tuple[str, list[str], int]]) -> Iterator[str]:
    """Panels beside each other, below their names."""
    gap = " " * _GAP
    yield gap.join(_cut(title, width).ljust(width) for title, _, width in row).rstrip()
    for number in range(max((len(lines) for _, lines, _ in row), default=0)):
        yield gap.join(lines[number] if number < len(lines) else " " * width for _, lines, width in row)
    yield ""


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: max(width - 1, 0)] + "…"


def told(panel: Image | Curves) -> str:
    """A panel in words: its name, and the ends of its scale."""
    from .benchmarks.looks.panel import Image

    if isinstance(panel, Image):
        return plain_text(f"{panel.title}: {panel.low:.4g} … {panel.high:.4g} {panel.unit}")
    y = np.concatenate([line.y for line in panel.lines])
    ends = f"{np.nanmin(y):.4g} … {np.nanmax(y):.4g}" if np.isfinite(y).any() else "no values"
    return plain_text(f"{panel.title}: {panel.y}: {ends}")


def colour_blocks(samples: Colours) -> list[str]:
    """Lines of half blocks: the upper half of each character shows one row of samples (row, col, 3), the lower the next."""
    return half_blocks([[f"2;{r};{g};{b}" for r, g, b in line] for line in samples.tolist()])


def half_blocks(codes: Sequence[Sequence[str]]) -> list[str]:
    """Lines of half blocks of colour codes (row, col), as they stand behind 38; and 48; (ISO 8613-6); an odd last row twice."""
    even = [*codes, codes[-1]] if len(codes) % 2 else codes
    return [
        "".join(f"\x1b[38;{a};48;{b}m▀" for a, b in zip(upper, lower, strict=True)) + "\x1b[0m"
        for upper, lower in zip(even[::2], even[1::2], strict=True)
    ]


def grey_blocks(samples: Colours) -> list[str]:
    """Lines of shaded blocks without colour, each the mean luminance (Rec. 709) of two rows of samples."""
    even = np.vstack([samples, samples[-1:]]) if len(samples) % 2 else samples
    light = (even @ np.array([0.2126, 0.7152, 0.0722])).reshape(len(even) // 2, 2, -1).mean(axis=1)
    level = np.minimum((light / 256.0 * len(_SHADES)).astype(int), len(_SHADES) - 1)
    return ["".join(_SHADES[int(one)] for one in line) for line in level]
