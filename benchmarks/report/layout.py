"""Placement of labels, limits and ticks of a logarithmic panel."""

from __future__ import annotations

import math
from typing import Any

__all__ = ["HEIGHT", "WIDTH", "log_domain", "log_ticks", "place_labels"]

#: Panels of the saved picture in px. Labels are placed for the narrower panels of the page, which suits both.
WIDTH, HEIGHT = 380, 300
_PLACED_WIDTH = 300
#: Points of one estimator closer than this, px, share one label.
_TOGETHER = 45


def place_labels(points: list[dict[str, Any]], cpus: list[float], errors: list[float]) -> None:
    """Place each label on a side of its point where it covers no point or label; `cpus` and `errors` span the axes.

    Further points of an estimator (other conditions) are labelled only where they are apart from the labelled ones.
    """
    if not points:
        return
    (x0, x1), (y0, y1) = log_domain(cpus), log_domain(errors)
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
    for point, (px, py) in sorted(zip(points, places, strict=True), key=lambda pair: not pair[0]["front"]):
        wide = 6.2 * len(point["text"])
        options = []
        for dy in (0, -13, 13, -24, 24, -36, 36, -48, 48):
            options += [
                ("left", 10, dy, px + 10),
                ("right", -10, dy, px - 10 - wide),
                ("center", 0, dy or -14, px - wide / 2),
            ]
        chosen, least = options[0], math.inf
        for rank, option in enumerate(options):
            left, middle = option[3], py + option[2]
            box = (left, middle - 6, left + wide, middle + 6)
            outside = (
                max(0.0, -left)
                + max(0.0, left + wide - _PLACED_WIDTH)
                + max(0.0, 4 - middle)
                + max(0.0, middle - HEIGHT)
            )
            own = _distance(box, (px, py))
            strangers = [at for at, other in zip(places, points, strict=True) if other["label"] != point["label"]]
            misread = sum(max(0.0, own + 4 - _distance(box, at)) for at in strangers)
            cost = rank + 6 * outside + 8 * misread + sum(_overlap(box, other) for other in taken)
            if cost < least:
                chosen, least = option, cost
        point["align"], point["dx"], point["dy"] = chosen[0], chosen[1], chosen[2]
        if point["text"]:
            taken.append((chosen[3], py + chosen[2] - 6, chosen[3] + wide, py + chosen[2] + 6))


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    return max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))


def _distance(box: tuple[float, float, float, float], at: tuple[float, float]) -> float:
    across = max(box[0] - at[0], 0.0, at[0] - box[2])
    return math.hypot(across, max(box[1] - at[1], 0.0, at[1] - box[3]))


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
