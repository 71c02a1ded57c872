"""Placement of labels, limits and ticks of a logarithmic panel."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["HEIGHT", "WIDTH", "log_domain", "log_ticks", "place_labels"]

Float = npt.NDArray[np.float64]

#: Panels of the saved picture in px. Labels are placed for the narrower panels of the page, which suits both.
WIDTH, HEIGHT = 380, 300
_PLACED_WIDTH = 300
#: Sides of a label, and heights over its point, px; the first costs least.
_SIDES = ("left", "right", "center")
_DROPS = (0, -13, 13, -24, 24, -36, 36, -48, 48)
#: Points of one estimator closer than this, px, share one label.
_TOGETHER = 45


def place_labels(points: list[dict[str, Any]], cpus: list[float], errors: list[float]) -> None:
    """Place each label on a side of its point where it covers no point or label; `cpus` and `errors` span the axes.

    Further points of an estimator (other conditions) are labelled only where they are apart from the labelled ones.
    """
    if not points:
        return
    known = tuple((p["label"], p["text"], p["cpu"], p["error"], bool(p["front"])) for p in points)
    for point, placed in zip(points, _placed(known, (min(cpus), max(cpus)), (min(errors), max(errors))), strict=True):
        point |= dict(zip(("text", "align", "dx", "dy"), placed, strict=True))


@lru_cache(maxsize=512)
def _placed(
    known: tuple[tuple[str, str, float, float, bool], ...], cpus: tuple[float, float], errors: tuple[float, float]
) -> list[tuple[str, str, int, int]]:
    """(text, align, dx, dy) of points (label, text, cpu, error, front). Page and saved picture place the same points."""
    points: list[dict[str, Any]] = [
        dict(zip(("label", "text", "cpu", "error", "front"), one, strict=True)) for one in known
    ]
    (x0, x1), (y0, y1) = log_domain(list(cpus)), log_domain(list(errors))
    taken: list[tuple[float, float, float, float]] = []
    places: list[tuple[float, float]] = []
    for point in points:
        px = _PLACED_WIDTH * math.log(point["cpu"] / x0) / math.log(x1 / x0)
        py = HEIGHT * (1 - math.log(point["error"] / y0) / math.log(y1 / y0))
        near = [
            math.hypot(px - x, py - y) < _TOGETHER and other["label"] == point["label"] and other["text"]
            for other, (x, y) in zip(points, places, strict=False)
        ]
        if any(near):
            point["text"] = ""
        places.append((px, py))
        taken.append((px - 6, py - 6, px + 6, py + 6))
    labels = np.array([point["label"] for point in points])
    at = np.array(places)
    for point, (px, py) in sorted(zip(points, places, strict=True), key=lambda pair: not pair[0]["front"]):
        wide = 6.2 * len(point["text"])
        left = np.tile([px + 10, px - 10 - wide, px - wide / 2], len(_DROPS))
        middle = py + np.repeat(_DROPS, 3)
        middle[2] = py - 14  # a centred label never lies on its point
        box = np.stack([left, middle - 6, left + wide, middle + 6])[:, :, None]
        outside = np.maximum(0, -left) + np.maximum(0, left + wide - _PLACED_WIDTH)
        outside += np.maximum(0, 4 - middle) + np.maximum(0, middle - HEIGHT)
        own = _distance(box, np.array([[px, py]]))
        misread = np.maximum(0, own + 4 - _distance(box, at[labels != point["label"]])).sum(axis=1)
        cost = np.arange(left.size) + 6 * outside + 8 * misread + _overlap(box, np.array(taken)).sum(axis=1)
        best = int(np.argmin(cost))
        dy = round(float(middle[best]) - py)
        point["align"], point["dx"], point["dy"] = _SIDES[best % 3], (10, -10, 0)[best % 3], dy
        if point["text"]:
            taken.append((left[best], middle[best] - 6, left[best] + wide, middle[best] + 6))
    return [(point["text"], point["align"], point["dx"], point["dy"]) for point in points]


def _overlap(box: Float, others: Float) -> Float:
    """Areas (option, other) that boxes (4, option, 1) share with others (other, 4)."""
    across = np.minimum(box[2], others[:, 2]) - np.maximum(box[0], others[:, 0])
    down = np.minimum(box[3], others[:, 3]) - np.maximum(box[1], others[:, 1])
    return np.asarray(np.maximum(0.0, across) * np.maximum(0.0, down))


def _distance(box: Float, at: Float) -> Float:
    """Distances (option, point) of boxes (4, option, 1) from points (point, 2)."""
    across = np.maximum(np.maximum(box[0] - at[:, 0], at[:, 0] - box[2]), 0.0)
    down = np.maximum(np.maximum(box[1] - at[:, 1], at[:, 1] - box[3]), 0.0)
    return np.asarray(np.hypot(across, down))


def log_domain(values: list[float]) -> tuple[float, float]:
    """Logarithmic limits with room for labels; at least half a decade, so that small differences are not exaggerated."""
    lo, hi = min(values), max(values)
    room = max(0.12 * math.log10(hi / lo), (0.5 - math.log10(hi / lo)) / 2, 0.05)
    return lo / 10**room, hi * 10 ** (room * 1.25)


def log_ticks(lo: float, hi: float) -> list[float]:
    """1, 2, 5 per decade inside the limits; over more than two decades only powers of ten."""
    steps = (1, 2, 5) if hi / lo < 100 else (1,)
    decades = range(math.floor(math.log10(lo)), math.ceil(math.log10(hi)) + 1)
    return [float(f"{step}e{decade}") for decade in decades for step in steps if lo <= step * 10.0**decade <= hi]
