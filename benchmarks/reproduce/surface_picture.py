"""Pictures of the objects: raw images as grey-level PNG (Figure 8), surfaces in three dimensions (Figure 9)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..report.pictures import SEQUENTIAL, lut, png

__all__ = ["object_pictures", "raw_image", "surface_svg"]

Array = NDArray[np.float64]

_GREY = ("#000000", "#ffffff")
_STEPS = 128
#: The view: turned to the side, and from above.
_AZIMUTH, _ELEVATION = math.radians(32.0), math.radians(28.0)
_WIDTH, _HEIGHT, _MARGIN = 400.0, 380.0, 12.0


def raw_image(grey: Array) -> bytes:
    """PNG of an image (row, col), its least value black and its greatest white, each pixel as 4 × 4."""
    return png(np.kron(grey, np.ones((4, 4))), float(grey.min()), float(grey.max()), _GREY)


def surface_svg(x_m: Array, y_m: Array, z_m: Array, limits: tuple[float, float]) -> str:
    """SVG of a surface z(x, y), m, seen from the side of the camera: quadrangles from the farthest to the nearest.

    Coloured by z over `limits`, near bright. Quadrangles with a NaN corner are omitted, as are those that span more than
    half of the limits: they would join the object to its background where nothing was measured.
    """
    lo, hi = limits
    z = np.clip(z_m, lo - (hi - lo), hi + (hi - lo))
    u = x_m * math.cos(_AZIMUTH) + (z - hi) * math.sin(_AZIMUTH)
    away = -x_m * math.sin(_AZIMUTH) + (z - hi) * math.cos(_AZIMUTH)
    v = y_m * math.cos(_ELEVATION) - away * math.sin(_ELEVATION)
    corners = [np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]]
    px, py, depth = (np.stack([a[c] for c in corners], axis=-1).reshape(-1, 4) for a in (u, v, away))
    zc = np.stack([z[c] for c in corners], axis=-1).reshape(-1, 4)
    keep = np.isfinite(zc).all(axis=1) & (np.ptp(np.nan_to_num(zc), axis=1) < 0.5 * (hi - lo))
    px, py, zc, depth = px[keep], py[keep], zc[keep], depth[keep]
    scale = min((_WIDTH - 2 * _MARGIN) / np.ptp(px), (_HEIGHT - 2 * _MARGIN) / np.ptp(py))
    px = 0.5 * _WIDTH + (px - 0.5 * (px.min() + px.max())) * scale
    py = 0.5 * _HEIGHT + (py - 0.5 * (py.min() + py.max())) * scale
    colours = lut(SEQUENTIAL, _STEPS)
    shade = np.clip(np.rint((hi - zc.mean(axis=1)) / (hi - lo) * (_STEPS - 1)), 0, _STEPS - 1).astype(int)
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}">',
             f'<rect width="{_WIDTH:.0f}" height="{_HEIGHT:.0f}" fill="#ffffff"/>']  # fmt: skip
    for i in np.argsort(-depth.mean(axis=1), kind="stable"):
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px[i], py[i], strict=True))
        red, green, blue = colours[shade[i]]
        fill = f"#{red:02x}{green:02x}{blue:02x}"
        parts.append(f'<polygon points="{points}" fill="{fill}" stroke="{fill}" stroke-width="0.4"/>')
    return "".join([*parts, "</svg>"])


def object_pictures() -> dict[str, tuple[str, bytes]]:
    """name -> (caption, PNG): raw images and reconstructed surfaces of both objects."""
    import vl_convert as vlc

    from ...estimators.gated.tools.stack import read_stack
    from .model import PRINTED, TIMES_COSINE
    from .objects import objects, read

    pair = objects()
    pictures: dict[str, tuple[str, bytes]] = {}
    for number, capture in enumerate(pair.clean, start=1):
        instrument = read_stack(capture).instrument
        counts = capture["counts"].values.astype(np.float64) - instrument.offset_dn
        pictures[f"figure-8-object-{number}"] = (
            f"Figure 8: Object {number}, all slices summed",
            raw_image(counts.sum(axis=0)),
        )
        rays = instrument.rays()
        truth = capture["truth_depth"].values
        limits = (float(np.nanmin(truth)) - 0.05, float(np.nanmax(truth)) + 0.05)
        shown = (
            ("truth", "truth", np.asarray(truth, dtype=np.float64)),
            ("printed", "Eq. 24 as printed, ⟨r⟩ taken as depth", read(capture, PRINTED).range),
            ("cosine", "cosine multiplied", read(capture, TIMES_COSINE).range * rays[..., 2]),
            ("offset", "weighted average with the offset that Table 1 needs",
             read(pair.raised[number - 1], "weighted-average").range * rays[..., 2]),
        )  # fmt: skip
        for slug, caption, z in shown:
            x, y = (truth * rays[..., axis] / rays[..., 2] for axis in (0, 1))
            svg = surface_svg(x, y, z, limits)
            name = f"figure-9-object-{number}-{slug}"
            pictures[name] = (f"Figure 9: Object {number}, {caption}", vlc.svg_to_png(svg, scale=1.0))
    return pictures
