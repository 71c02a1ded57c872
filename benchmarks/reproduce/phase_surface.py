"""Phases over a pupil drawn as surfaces, seen obliquely from above: phase upward, one scale for all of a set."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..report.pictures import DIVERGING, lut

__all__ = ["beside", "phase_svg"]

Float = NDArray[np.float64]

WIDTH, HEIGHT = 400, 300
_STEPS = 128
_AZIMUTH, _ELEVATION = math.radians(30.0), math.radians(35.0)
#: Pupil's radius, and the height of the greatest phase, in pixels.
_RADIUS, _TALL = 160.0, 68.0


def phase_svg(phase: Float, greatest: float, title: str = "") -> str:
    """SVG of a phase (rows, cols) [rad] over the square of its grid, NaN outside the pupil; ±`greatest` are the ends of height and
    colour. Quadrangles are painted from the farthest to the nearest, x to the right and y toward the viewer, both turned by 30°."""
    t = np.linspace(-1.0, 1.0, phase.shape[0])
    x, y = np.meshgrid(t, t)
    c, s = math.cos(_AZIMUTH), math.sin(_AZIMUTH)
    near = x * s + y * c
    across = 0.5 * WIDTH + _RADIUS * (x * c - y * s)
    up = _TALL * np.clip(phase / greatest, -1.3, 1.3) * math.cos(_ELEVATION)
    down = 0.5 * HEIGHT + _RADIUS * near * math.sin(_ELEVATION) - up
    corners = [np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]]
    px, py, depth, z = (np.stack([a[c] for c in corners], axis=-1).reshape(-1, 4) for a in (across, down, near, phase))
    keep = np.isfinite(z).all(axis=1)
    px, py, depth, z = px[keep], py[keep], depth[keep], z[keep]
    colours = lut(DIVERGING, _STEPS)
    shade = np.clip(np.rint((z.mean(axis=1) / greatest + 1.0) / 2.0 * (_STEPS - 1)), 0, _STEPS - 1).astype(int)
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}">',
             f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
             f'<text x="8" y="20" font-family="sans-serif" font-size="15">{title}</text>']  # fmt: skip
    for i in np.argsort(depth.mean(axis=1), kind="stable"):
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px[i], py[i], strict=True))
        red, green, blue = colours[shade[i]]
        parts.append(
            f'<polygon points="{points}" fill="#{red:02x}{green:02x}{blue:02x}" stroke="#555555" stroke-width="0.3"/>'
        )
    return "".join([*parts, "</svg>"])


def beside(surfaces: list[str], columns: int) -> str:
    """Pictures of `phase_svg` in one SVG, `columns` in a row."""
    rows = -(-len(surfaces) // columns)
    parts = [
        part.replace("<svg ", f'<svg x="{WIDTH * (n % columns)}" y="{HEIGHT * (n // columns)}" ', 1)
        for n, part in enumerate(surfaces)
    ]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{columns * WIDTH}" height="{rows * HEIGHT}">'
    return "".join([head, *parts, "</svg>"])
