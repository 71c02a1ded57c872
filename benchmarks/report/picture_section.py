"""The pictures of a run on its page: per scene the truth, every estimate and its error on shared scales, and their reliefs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .numbers import number, rate
from .pictures import DIVERGING, MAX_SIDE, SEQUENTIAL, Picture, css_gradient, data_uri, error_limit, png, value_limits
from .surfaces import SIDE, coarse, packed, relief

__all__ = ["BUDGET", "RELIEF_BUDGET", "picture_scenes", "reliefs_of"]

#: Bytes of all pictures of a page, as text. With the bundled chart library (0.9 MB) and the tables it stays below 10 MB.
BUDGET = 5_000_000
#: Bytes of all reliefs, as text. Each sample of an estimate takes two bytes for its value and two for its error.
RELIEF_BUDGET = 2_000_000
#: Sides to which pictures are reduced until they fit the budget, samples.
_SIDES = (MAX_SIDE, 224, 160, 112, 80, 56, 40)


def picture_scenes(pictures: list[Picture], order: list[str], *, budget: int = BUDGET) -> list[dict[str, Any]]:
    """One entry per scene, condition and quantity with the truth, the estimates in `order`, and the scales.

    Pictures are reduced, all alike, until they fit the budget.
    """
    groups: dict[tuple[str, str, str], list[Picture]] = {}
    for picture in pictures:
        groups.setdefault((picture.scene, picture.condition, picture.quantity), []).append(picture)
    sorted_groups = [sorted(group, key=lambda p: _rank(p, order)) for group in groups.values()]
    result: list[dict[str, Any]] = []
    for side in _SIDES:
        result = [_scene(group, side) for group in sorted_groups]
        if sum(_bytes(scene) for scene in result) <= budget:
            break
    return result


def _rank(picture: Picture, order: list[str]) -> int:
    return order.index(picture.estimator) if picture.estimator in order else len(order)


def _bytes(scene: dict[str, Any]) -> int:
    return len(scene["truth"]) + sum(len(entry["value"]) + len(entry["error"]) for entry in scene["entries"])


def _limits(group: list[Picture]) -> tuple[float, float, float]:
    """Ends of the scale of values, and half the width of the scale of errors."""
    factor, _ = group[0].shown
    lo, hi = value_limits(group[0].truth, 10.0 / factor)
    return lo, hi, error_limit(group)


def _scene(group: list[Picture], side: int) -> dict[str, Any]:
    first = group[0]
    factor, unit = first.shown
    lo, hi, limit = _limits(group)
    entries = []
    for picture in group:
        due = np.isfinite(picture.truth)
        answered = ~(due & ~picture.valid)
        beyond = abs(picture.error[due & picture.valid]) > limit
        images = [
            data_uri(png(np.where(picture.valid, of, np.nan), *ends, colours, answered=answered, side=side))
            for of, ends, colours in (
                (picture.value, (lo, hi), SEQUENTIAL), (picture.error, (-limit, limit), DIVERGING),
            )
        ]  # fmt: skip
        entries.append({
            "label": picture.estimator, "value": images[0], "error": images[1],
            "invalid": rate(float((due & ~picture.valid).sum() / max(1, due.sum()))),
            "beyond": rate(float(beyond.mean()) if beyond.size else 0.0),
            "rms": _rms(picture.error[due & picture.valid], factor, unit),
        })  # fmt: skip
    return {
        "name": first.scene,
        "condition": first.condition,
        "truth": data_uri(png(first.truth, lo, hi, SEQUENTIAL, side=side)),
        "entries": entries,
        "quantity": first.quantity,
        "unit": first.unit,
        "error_unit": unit,
        "value_bar": css_gradient(SEQUENTIAL),
        "error_bar": css_gradient(DIVERGING),
        "value_ticks": _value_ticks(lo, hi),
        "error_ticks": [f"−{limit * factor:g}", "0", f"+{limit * factor:g}"],
    }


def _rms(error: NDArray[Any], factor: float, unit: str) -> str:
    value = math.sqrt(float(np.mean(np.square(error, dtype=np.float64)))) * factor if error.size else math.nan
    return f"{number(value)} {unit}"


def _value_ticks(lo: float, hi: float) -> list[str]:
    digits = 4 if hi - lo < 0.1 else 3 if hi - lo < 1 else 2
    return [f"{lo:.{digits}f}", f"{(lo + hi) / 2:.{digits}f}", f"{hi:.{digits}f}"]


def reliefs_of(pictures: list[Picture], order: list[str]) -> list[dict[str, Any]]:
    """One record per scene, condition and quantity for the 3-D view: grid size, scales, truth and estimates, packed.

    Many pictures have coarser grids, so that all fit `RELIEF_BUDGET`.
    """
    side = min(SIDE, max(12, int(math.sqrt(RELIEF_BUDGET / (16 / 3 * max(1, len(pictures)))))))
    groups: dict[tuple[str, str, str], list[Picture]] = {}
    for picture in pictures:
        groups.setdefault((picture.scene, picture.condition, picture.quantity), []).append(picture)
    result = []
    for group in groups.values():
        lo, hi, limit = _limits(group)
        # Estimates leave the span of the truth by their errors; beyond this they are drawn at its ends.
        lo, hi = lo - 2 * limit, hi + 2 * limit
        first = coarse(group[0].truth, side)
        factor, unit = group[0].shown
        result.append({
            "scene": group[0].scene, "quantity": group[0].quantity, "unit": group[0].unit, "error_unit": unit,
            "rows": first.shape[0], "cols": first.shape[1], "lo": lo, "hi": hi, "limit": limit * factor,
            "truth": packed(first, lo, hi),
            "estimates": {
                p.estimator: relief(p, lo, hi, limit, side) for p in sorted(group, key=lambda p: _rank(p, order))
            },
        })  # fmt: skip
    return result
