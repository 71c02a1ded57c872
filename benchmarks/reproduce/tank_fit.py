"""The range-error procedure of Kusters 1992, sections 4.3 and 4.4: a model of tank and target for each data set, then the error of
every point along its line from the laser, in bins of range.

- Floor: the mean `down` of points in a band about it, as wide as the predicted error (Figure 3.6) at their range; points within
  twice that of target or wall are left out. Iterated, since these are fitted with it. The thesis begins by eye; here the first
  guess is a high quantile, as nothing lies beyond floor and wall.
- Wall: likewise from `out`, without regard to the target. Both anew for every profile.
- Target: for every profile the place on the floor that minimises the range errors of the points on it; its distance from the wall,
  averaged over the profiles, is that of the data set.
- Error: model's range less measured range along the line from the laser through the point. The thesis averages "accumulated
  errors"; a mean of signed ones would tend to zero, so that |e| is meant. Bins of fewer than 100 values are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from .tank_sets import Section

__all__ = ["Bins", "binned", "fit_sections", "range_errors"]

Float = NDArray[np.float64]
#: Predicted error [m] of ranges [m].
Band = Callable[[Float], Float]

#: Rounds of the iteration; fewest values of a bin (sec. 4.3.2).
_ROUNDS, _LEAST = 12, 100
#: Quantile of `down` and `out` that the iteration begins with: nothing lies beyond floor and wall, and each holds more points.
_FARTHEST = 0.93


@dataclass(frozen=True)
class Bins:
    """Errors by range: middle of the bin, mean |e|, rms, greatest |e| and mean e, all m, and the number of values."""

    range_m: Float
    mean: Float
    rms: Float
    greatest: Float
    bias: Float
    count: Float


def fit_sections(profiles: list[tuple[Float, Float]], from_wall_m: float, radius_m: float, band: Band) -> list[Section]:
    """The model of every profile (down, out) [m] of one data set.

    Main arguments:
        from_wall_m: first guess of the target's distance from the wall, by eye in the thesis. radius_m: of the target, known.

    Raises ValueError where a profile shows no floor or no wall.
    """
    fitted = [_walls(down, out, from_wall_m, radius_m, band) for down, out in profiles]
    held = float(from_wall_m)
    for _ in range(3):  # the target moves the points that floor and target take, and these the target
        places = [_target(*p, *f, held, radius_m, band) for p, f in zip(profiles, fitted, strict=True)]
        held = float(np.mean([place for place in places if np.isfinite(place)]))
        fitted = [_walls(down, out, held, radius_m, band) for down, out in profiles]
    return [Section(floor, wall, wall - held, radius_m) for floor, wall in fitted]


def _walls(down: Float, out: Float, from_wall_m: float, radius_m: float, band: Band) -> tuple[float, float]:
    """(floor, wall) [m] of one profile."""
    reach = band(np.hypot(down, out))
    floor, wall = float(np.quantile(down, _FARTHEST)), float(np.quantile(out, _FARTHEST))
    for _ in range(_ROUNDS):
        centre_down, centre_out = floor - radius_m, wall - from_wall_m
        off_target = np.abs(np.hypot(down - centre_down, out - centre_out) - radius_m) > 2.0 * reach
        off_target &= np.hypot(down - centre_down, out - centre_out) > radius_m
        on_floor = (np.abs(down - floor) < reach) & off_target & (np.abs(out - wall) > 2.0 * reach)
        on_wall = (np.abs(out - wall) < reach) & (np.abs(down - floor) > 2.0 * reach)
        if not on_floor.any() or not on_wall.any():
            raise ValueError("a profile of the tank shows no floor or no wall")
        floor, wall = float(down[on_floor].mean()), float(out[on_wall].mean())
    return floor, wall


def _target(
    down: Float, out: Float, floor: float, wall: float, from_wall_m: float, radius_m: float, band: Band
) -> float:
    """Distance of the target from the wall that minimises the rms range error of the points on it; NaN where there are too few."""
    reach = band(np.hypot(down, out))
    centre = np.array([floor - radius_m, wall - from_wall_m])
    on = np.abs(np.hypot(down - centre[0], out - centre[1]) - radius_m) < 2.0 * reach
    on &= (floor - down > 2.0 * reach) if radius_m > 0.05 else (floor - down > reach)
    if on.sum() < 5:
        return float("nan")

    def cost(apart: float) -> float:
        model = Section(floor, wall, wall - apart, radius_m)
        return float((range_errors(down[on], out[on], model)[0] ** 2).sum())

    span = max(float(reach.max()), 0.01)
    return float(minimize_scalar(cost, bounds=(from_wall_m - span, from_wall_m + span), method="bounded").x)


def range_errors(down: Float, out: Float, section: Section) -> tuple[Float, Float]:
    """(model's range less measured range, model's range) [m] along the line from the laser through each point."""
    model = section.distance(np.arctan2(out, down))
    return model - np.hypot(down, out), model


def binned(error: Float, range_m: Float, width_m: float) -> Bins:
    """The errors in bins of range of `width_m`, those of 100 or more values."""
    index = np.floor(range_m / width_m).astype(np.int64)
    rows = []
    for k in np.unique(index):
        e = error[index == k]
        if e.size >= _LEAST:
            rows.append(
                ((k + 0.5) * width_m, np.abs(e).mean(), np.sqrt((e**2).mean()), np.abs(e).max(), e.mean(), e.size)
            )
    table = np.array(rows, np.float64).reshape(-1, 6)
    return Bins(*table.T)
