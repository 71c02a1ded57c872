"""Kusters 1992, chapter 4: Tables 4.1 and 4.2, Eq. 4.6 and 4.7, and the range errors of Figures 4.14 and 4.15."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...optics.pixel_step import opposite_eq4_5, reciprocal_eq4_7, reciprocal_in_inverse, small_angle_eq4_6
from ...scenes.rigs.laser_line import laser_line_rig
from .error_budget import RANGES_M, budget
from .range_error_fits import fit_reciprocal, fit_reciprocal_in_inverse
from .rows import Row, judge_band, judge_exact
from .tank_errors import PROFILES, Observed, observed, predicted
from .tank_fit import Bins
from .tank_frames import Plane, section_line
from .tank_sets import SETS, DataSet, tank_scene

__all__ = ["ITEMS", "loss_rows", "misfit", "over_predicted", "tank_rows"]

_DOCUMENT = "001"
#: Items, as docs/coverage.csv names them.
ITEMS = ("Eq. 4.6", "Eq. 4.7", "Figure 4.14", "Figure 4.15", "Table 4.1", "Table 4.2")

_NAN = math.nan
#: Half of the last printed digit of the tables [m].
_HALF_M = 0.005
#: "Significant error begins to occur beyond 2.5 m"; "at approximately 3.5 m there is a distinct break"; "lost at about 4 m".
_SIMILAR_M, _BREAK_M, _LOST_M = 2.5, 3.5, 4.0
#: Least rise that is a break.
_BREAKS = 1.3
_NAMES = {"line-peak": "whole pixels", "line-centroid": "centres of mass"}
_FREE = (
    "index of water at 25 degrees; lens's point spread; port; threshold; noise; exposure that keeps the brightest pixel at 200 DN; "
    f"sway of 2 mm; {PROFILES} profiles of a set; bins of .1 m"
)
Float = NDArray[np.float64]


def tank_rows() -> list[Row]:
    """All rows, in the order of ITEMS."""
    return [*_equation_rows(), *_break_rows(), *loss_rows(), *_figure_15_rows(), *_table_1_rows(), *_table_2_rows()]


# --- equations ------------------------------------------------------------------------------------------------------


def misfit(range_m: Float, error_m: Float) -> tuple[float, float]:
    """Greatest relative misfit of Eq. 4.7 as printed, and in 1/r, each fitted by least squares of the reciprocal."""
    made = []
    for fit, form in ((fit_reciprocal, reciprocal_eq4_7), (fit_reciprocal_in_inverse, reciprocal_in_inverse)):
        made.append(float(np.abs(form(range_m, fit(range_m, error_m)) / error_m - 1.0).max()))
    return made[0], made[1]


def _equation_rows() -> list[Row]:
    opposite = math.atan2(0.15, 1.0)
    step = 11.1e-3 / 192 / 25e-3 / 1.33
    ratio = float(
        small_angle_eq4_6(0.15, 0.5 * math.pi - opposite, step) / opposite_eq4_5(0.15, 0.5 * math.pi - opposite, step)
    )
    r = np.linspace(0.7, 4.0, 67)
    printed, followed = misfit(r, predicted(r))
    return [
        Row(
            ITEMS[0], "angle of the ray at 1 m with a baseline of .15 m", "degree", 81.5, math.degrees(0.5 * math.pi - opposite),
            0.05, judge_exact(81.5, math.degrees(0.5 * math.pi - opposite), 0.05), "above this the opposite angle is small", "",
            _DOCUMENT,
        ),
        Row(
            ITEMS[0], "Eq. 4.6 over Eq. 4.5 at 1 m", "1", _NAN, ratio, 0.01,
            "arithmetic" if abs(ratio - 1.0) <= 0.01 else "contradicted", "small angles, to a hundredth", "", _DOCUMENT,
        ),
        Row(
            ITEMS[1], "greatest relative misfit of 1/(quadratic in r) to the predicted error, .7 to 4 m", "1", _NAN, printed, _NAN,
            "contradicted" if printed > 3.0 * followed else "trend",
            f"from Eq. 4.6 the reciprocal is quadratic in 1/r, not in r; that form misses by {followed:.2g}", "index 1.33",
            _DOCUMENT,
        ),
    ]  # fmt: skip


# --- figures --------------------------------------------------------------------------------------------------------


def _mean_at(bins: Bins, range_m: float) -> float:
    """Mean |error| [mm] at a range: of the two bins beside it, by their numbers."""
    near = np.abs(bins.range_m - range_m) < 0.06
    return 1e3 * float(np.average(bins.mean[near], weights=bins.count[near]))


def over_predicted(found: Observed, low_m: float, high_m: float) -> float:
    """Mean over the points between two ranges of |error| over the predicted greatest error."""
    held = (found.range_m >= low_m) & (found.range_m < high_m)
    return float((np.abs(found.error_m[held]) / predicted(found.range_m[held])).mean())


def _break_rows() -> list[Row]:
    crossed = _columns(SETS[4])
    rows = []
    for name, shown in _NAMES.items():
        found = observed(name)
        at_one = _mean_at(found.bins, 1.0)
        ratio = over_predicted(found, _BREAK_M, 4.5) / over_predicted(found, _SIMILAR_M, 3.2)
        rows += [
            Row(
                ITEMS[2], f"mean error at 1 m, {shown}", "mm", 5.0, at_one, 0.5, judge_band(5.0, at_one, at_one, 0.5),
                "the text: 'these tests confirm 5-mm accuracy at 1-m range'; the only errors here are those of the readout: "
                "the rest is the instrument's lens or calibration", _FREE, _DOCUMENT,
            ),
            Row(
                ITEMS[2], f"error beyond 3.5 m over that from 2.5 to 3.2 m, each over the predicted one, {shown}", "1", _NAN,
                ratio, _NAN, "trend" if ratio > _BREAKS else "undetermined",
                "the text: a distinct break, all from data set 5, without explanation; none here. By Table 4.2 no other set "
                f"reaches beyond 3.25 m, and its line crosses {crossed:.1f} columns: an error of that set's own, in a wall or "
                "in calibration, cannot be told from the phases of so few pixels", _FREE, _DOCUMENT,
            ),
        ]  # fmt: skip
    return rows


def _columns(data_set: DataSet) -> float:
    """Columns that the line of a data set crosses from end to end."""
    scene = tank_scene(data_set)
    camera = laser_line_rig(scene).camera
    line = section_line(Plane.of(scene, data_set.view_deg), data_set.section, camera.rows, camera.cols, 0.0, 0.0)
    return float(np.nanmax(line.column) - np.nanmin(line.column))


def _edge_rad() -> float:
    """Angle in water of the sensor's edge from the axis: 192 columns on 11.1 mm, a lens of 25 mm, n = 1.33."""
    return math.asin(math.sin(math.atan(0.5 * 11.1e-3 / 25e-3)) / 1.33)


def loss_rows() -> list[Row]:
    """The loss of the line near 4 m: what each cause would need."""
    farthest = max(data_set.section.corner_m for data_set in SETS)
    leaves = 0.15 / math.tan(math.radians(10.0) - _edge_rad())
    turn = math.degrees(math.atan2(0.15, _LOST_M) + _edge_rad())
    weaker = float((1.0 / _LOST_M) ** 2 * math.exp(-2.0 * 0.0445 * (_LOST_M - 1.0)))
    return [
        Row(
            ITEMS[2], "farthest point of the tank in any data set, against the loss of the line", "m", _LOST_M, farthest, 0.1,
            "undetermined" if farthest <= _LOST_M + 0.1 else "contradicted",
            "the text: detection is lost at about 4 m. Nothing stood farther away in the tank, so that its data show no limit "
            "of the instrument", "", _DOCUMENT,
        ),
        Row(
            ITEMS[2], "range at which the line leaves the sensor of a camera turned by 10 degrees", "m", _LOST_M, leaves, 0.5,
            judge_band(_LOST_M, leaves, leaves, 0.5),
            f"the sensor's edge is no cause, unless the camera was turned by {turn:.1f} degrees", "index 1.33", _DOCUMENT,
        ),
        Row(
            ITEMS[2], "light of a row at 4 m over that at 1 m in clear water", "1", _NAN, weaker, _NAN, "undetermined",
            "1/r² and attenuation; a threshold above this share of the light at 1 m loses the line at 4 m, unless exposure and "
            "gain make up for it; none of these is given", "attenuation .0445 1/m", _DOCUMENT,
        ),
    ]  # fmt: skip


def _figure_15_rows() -> list[Row]:
    rows = []
    for name, shown in _NAMES.items():
        found = observed(name)
        near, far = over_predicted(found, 0.7, _SIMILAR_M), over_predicted(found, _SIMILAR_M, 4.5)
        rows += [
            Row(
                ITEMS[3], f"mean error over the predicted greatest, below 2.5 m, {shown}", "1", _NAN, near, _NAN,
                "trend" if abs(near - 1.0) <= 0.25 else "contradicted", "the text: very similar; the readout alone gives less",
                _FREE, _DOCUMENT,
            ),
            Row(
                ITEMS[3], f"mean error over the predicted greatest, beyond 2.5 m, {shown}", "1", 2.0, far, 0.3,
                judge_band(2.0, far, far, 0.3), "the text: almost a factor of two", _FREE, _DOCUMENT,
            ),
        ]  # fmt: skip
    at = RANGES_M.index(3.0)
    missing = 2.0 * float(predicted(np.array(3.0)))
    known = {s.name: abs(s.error_m[at]) for s in budget() if s.kind == "shift"}
    largest = max(known, key=lambda key: known[key])
    row = Row(
        ITEMS[3], "error that would have to be added at 3 m", "mm", _NAN, 1e3 * missing, _NAN,
        "undetermined" if known[largest] < missing else "trend",
        f"twice the predicted one; of the sources that the text names the largest of assumed size, {largest}, gives "
        f"{1e3 * known[largest]:.0f} mm; sizes are not given, so none is fitted", "sizes of the sources", _DOCUMENT,
    )  # fmt: skip
    return [*rows, row]


# --- tables ---------------------------------------------------------------------------------------------------------


def _table_1_rows() -> list[Row]:
    rows = []
    for data_set in SETS:
        section = data_set.section
        # Both lengths are rounded, and so is the printed range.
        rounding = _HALF_M * (1.0 + (section.floor_m + section.wall_m) / section.corner_m)
        rows.append(
            Row(
                ITEMS[4],
                f"range of the corner from Table 4.2, data set {data_set.number}",
                "m",
                data_set.corner_range_m,
                section.corner_m,
                rounding,
                judge_exact(data_set.corner_range_m, section.corner_m, rounding),
                "square root of the sum of squares of its wall locations",
                "",
                _DOCUMENT,
            )
        )
        centre = float(np.hypot(*section.centre))
        rows.append(
            Row(
                ITEMS[4],
                f"range of the target's centre from Table 4.2, data set {data_set.number}",
                "m",
                data_set.target_range_m,
                centre,
                rounding + _HALF_M,
                judge_exact(data_set.target_range_m, centre, rounding + _HALF_M),
                "nor does its nearest point agree; on the floor below the centre it is "
                f"{math.hypot(section.floor_m, section.target_out_m):.2f} m",
                "",
                _DOCUMENT,
            )
        )
    return rows


def _table_2_rows() -> list[Row]:
    rows = []
    for name, shown in _NAMES.items():
        found = observed(name).sections
        apart = [
            abs(value)
            for data_set in SETS
            for value in (
                found[data_set.number].floor_m - data_set.floor_m, found[data_set.number].wall_m - data_set.wall_m,
            )
        ]  # fmt: skip
        rows.append(
            Row(
                ITEMS[5],
                f"greatest error of a wall that the procedure finds, {shown}",
                "mm",
                _NAN,
                1e3 * max(apart),
                _NAN,
                "undetermined",
                "the frames are made from this table; the procedure's own error is what is shown",
                _FREE,
                _DOCUMENT,
            )
        )
    return rows
