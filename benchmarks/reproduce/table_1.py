"""Table 1: depth errors of two objects by weighted average and by the proposed model, and their possible causes.

Two readings (explanations) fit the weighted average of Object 1 with one parameter each, a third fits both numbers of
Object 1 with two. All three are then applied to the other cells without refitting, over rigs that the document does not exclude.

"offset": a level B in every slice pulls each range to the middle of the delays and so compresses the depth. Eq. 24 enters
    without its cosine, as r³/r².
"radial": the radial range, which time of flight measures, is taken as the orthogonal distance (the subject of section 4).
"both": the two at once, with Eq. 24 as printed (`combined.py`).

Three readings need no fit of a rig, and weigh against these: a threshold of 10 % on the samples, one error of constant length
per method, and one constant percentage per method. A prediction is worth something only if the last two fail.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from .accuracy import DEPTHS_M, SIGMA_TIMES_STEP_S2
from .combined import Fits, fits
from .rows import Row, Verdict, judge_band
from .stacks import depth, fitted_offset, plausible_rigs

__all__ = [
    "PUBLISHED", "bands", "guesses", "offset_share", "radial_angle", "shares", "table_1_points", "table_1_rows",
]  # fmt: skip

Array = NDArray[np.float64]

#: Absolute depth error in %, Object 1 and 2.
PUBLISHED = {"set-up": (1.85, 2.22), "weighted average": (12.65, 14.11), "proposed": (2.26, 2.93)}
_THRESHOLD = 0.1
_METHODS: dict[str, dict[str, Any]] = {
    "weighted average": {},
    "r³/r²": {"cubic": True},
    "weighted average over 10 %": {"threshold": _THRESHOLD},
    "r³/r² over 10 %": {"cubic": True, "threshold": _THRESHOLD},
}


def offset_share(error: float) -> float:
    """KB/S for which an offset compresses a depth by `error` = KB/(S + KB), for equal signals of object and background."""
    return error / (1.0 - error)


@lru_cache(maxsize=1)
def _offset_errors() -> tuple[Array, dict[str, Array]]:
    """(offsets (rig), |depth error| in % (rig, object) by method) with the offset of each rig fitted on Object 1."""
    deepest = DEPTHS_M[0]
    offsets, errors = [], {name: [] for name in _METHODS}  # type: ignore[var-annotated]
    for rig in plausible_rigs(SIGMA_TIMES_STEP_S2, deepest):
        offset = fitted_offset(rig, DEPTHS_M[0], PUBLISHED["weighted average"][0] / 100.0, deepest)
        if math.isnan(offset):
            continue
        offsets.append(offset)
        for name, options in _METHODS.items():
            found = [
                depth(rig, d, s, offset, deepest, **options) for d, s in zip(DEPTHS_M, (1.0, rig.weaker), strict=True)
            ]
            errors[name].append([100.0 * abs(f / d - 1.0) for f, d in zip(found, DEPTHS_M, strict=True)])
    return np.array(offsets), {name: np.array(value) for name, value in errors.items()}


def bands() -> dict[tuple[str, int], tuple[float, float, float]]:
    """(median, least, largest) of |depth error| in % by (method, object) under the reading "offset", all rigs.

    The full range is given, since a percentile over a grid of our choice would be meaningless.
    """
    _, errors = _offset_errors()
    return {(name, number): _spread(value[:, number - 1]) for name, value in errors.items() for number in (1, 2)}


def radial_angle(background_m: float, filled: float, depth_m: float, error_m: float) -> float:
    """Mean angle θ of the background, rad, at which radial distances taken as orthogonal give a depth error of `error_m`.

    z_b(secθ − 1) − z_o(sec(fθ) − 1) = error, f = `filled`: mean angle of the object over that of the background.
    """
    low, high = 0.0, 1.2
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radial(background_m, filled, depth_m, middle, 1.0) < error_m else (low, middle)
    return 0.5 * (low + high)


def _radial(background_m: float, filled: float, depth_m: float, angle: float, power: float) -> float:
    """Depth error, m, where each distance is z·sec^power of its angle: 1 radial, 2 radial divided by the cosine."""
    near = (background_m - depth_m) * (math.pow(math.cos(filled * angle), -power) - 1.0)
    return background_m * (math.pow(math.cos(angle), -power) - 1.0) - near


@lru_cache(maxsize=1)
def _radial_errors() -> dict[str, Array]:
    """|depth error| in % (rig, object) under the reading "radial", its angle fitted on Object 1.

    "×cos": the cosine of Eq. 24 as a factor; the remaining error is that of r³/r², about 2σ²(1/z_b − 1/z_o).
    """
    errors: dict[str, list[list[float]]] = {"weighted average": [], "printed": [], "×cos": []}
    wanted = PUBLISHED["weighted average"][0] / 100.0 * DEPTHS_M[0]
    for background in (3.0, 5.0, 10.0):
        for filled in (0.0, 0.25, 0.5, 0.75, 0.9):
            angle = radial_angle(background, filled, DEPTHS_M[0], wanted)
            for sigma in (0.9e-9, 1.8e-9, 3.0e-9):
                spread = 2.0 * (0.5 * C_M_PER_S * sigma) ** 2
                cubic = [spread * (1.0 / background - 1.0 / (background - d)) for d in DEPTHS_M]
                for name, power in (("weighted average", 1.0), ("printed", 2.0), ("×cos", 0.0)):
                    moved = [0.0, 0.0] if name == "weighted average" else cubic
                    found = [
                        _radial(background, filled, d, angle, power) + m for d, m in zip(DEPTHS_M, moved, strict=True)
                    ]
                    errors[name].append([100.0 * abs(f) / d for f, d in zip(found, DEPTHS_M, strict=True)])
    return {name: np.array(value) for name, value in errors.items()}


def _spread(column: Array) -> tuple[float, float, float]:
    return float(np.median(column)), float(column.min()), float(column.max())


def table_1_points() -> list[dict[str, Any]]:
    """The chart of Table 1: published values and bands, % of the depth."""
    points = []
    found, both = bands(), _combined()
    radial = {(name, n): _spread(value[:, n - 1]) for name, value in _radial_errors().items() for n in (1, 2)}
    fitted = {(k, n): _spread(np.abs(e[:, k])) for n, e in ((1, both.error1), (2, both.error2)) for k in (0, 1)}
    for number in (1, 2):
        cells = [
            ("weighted average, offset", PUBLISHED["weighted average"], found["weighted average", number]),
            ("weighted average, radial", PUBLISHED["weighted average"], radial["weighted average", number]),
            ("weighted average, both", PUBLISHED["weighted average"], fitted[0, number]),
            ("proposed without cosine, offset", PUBLISHED["proposed"], found["r³/r²", number]),
            ("proposed as printed, radial", PUBLISHED["proposed"], radial["printed", number]),
            ("proposed as printed, both", PUBLISHED["proposed"], fitted[1, number]),
            ("proposed, 10 % threshold, offset", PUBLISHED["proposed"], found["r³/r² over 10 %", number]),
            ("proposed, cosine multiplied, radial", PUBLISHED["proposed"], radial["×cos", number]),
        ]
        points += [
            {"object": f"Object {number}", "reading": name, "published": printed[number - 1],
             "median": band[0], "low": band[1], "high": band[2]}
            for name, printed, band in cells
        ]  # fmt: skip
    return points


def table_1_rows() -> list[Row]:
    """Rows of Table 1. Its set-up column is Eq. 25; numbers to which a reading was fitted have no row."""
    return [*_offset_rows(), *_radial_rows(), *_both_rows(), *_length_rows(), *_share_rows()]


def guesses(column: str) -> dict[str, float]:
    """Errors of Object 2, %, that need no model: those of Object 1 in per cent, and in millimetres."""
    first = PUBLISHED[column][0]
    return {"same percentage": first, "same length": first * DEPTHS_M[0] / DEPTHS_M[1]}


def _tolerance(number: int) -> float:
    """The accuracy of the set-up according to the document, in % of the depth."""
    return PUBLISHED["set-up"][number - 1]


def _row(reading: str, number: int, column: str, what: str, band: tuple[float, float, float], verdict: Verdict, note: str,
         free: str) -> Row:  # fmt: skip
    return Row(
        "Table 1", f"Object {number}, {what}, reading «{reading}»", "%", PUBLISHED[column][number - 1], band[0],
        _tolerance(number), verdict, f"{band[1]:.2f} … {band[2]:.2f} %; {note}", free,
    )  # fmt: skip


def _judge(number: int, column: str, band: tuple[float, float, float]) -> Verdict:
    """As `judge_band`; agreement on Object 2 says nothing where a guess from Object 1 agrees too."""
    free = guesses(column).values() if number == 2 else ()
    return judge_band(PUBLISHED[column][number - 1], band[1], band[2], _tolerance(number), free)


def _offset_rows() -> list[Row]:
    offsets, errors = _offset_errors()
    found = bands()
    free = "offset B, fitted on Object 1's weighted average; rig"
    others = f"band: {offsets.size} rigs (σ, range, window, reflectivities of background and Object 2 are not printed)"
    cells = (
        (2, "weighted average", "weighted average", "weighted average",
         "the lower end requires Object 2 to be nearly as bright as Object 1"),
        (1, "proposed", "proposed without its cosine (r³/r²)", "r³/r²", "_worse"),
        (2, "proposed", "proposed without its cosine (r³/r²)", "r³/r²", "_worse"),
        (1, "proposed", "proposed with a 10 % threshold", "r³/r² over 10 %", "the threshold improves it, not r³/r²"),
        (2, "proposed", "proposed with a 10 % threshold", "r³/r² over 10 %",
         "the threshold improves it, not r³/r²; w_i of Eq. 23 may include one, the document does not say"),
    )  # fmt: skip
    rows = []
    for number, column, what, method, note in cells:
        band = found[method, number]
        if note == "_worse":
            worse = float(np.mean(errors[method][:, number - 1] > errors["weighted average"][:, number - 1]))
            note = (f"larger than the error of the weighted average in {100 * worse:.0f} % of rigs; Eq. 24 as printed also "
                    "divides by a cosine, see reading «both»")  # fmt: skip
        near = float(
            np.mean(np.abs(errors[method][:, number - 1] - PUBLISHED[column][number - 1]) <= _tolerance(number))
        )
        rows.append(_row("offset", number, column, what, band, _judge(number, column, band),
                         f"{others}; {100 * near:.0f} % of rigs within the tolerance; {note}", free))  # fmt: skip
    return rows


def _radial_rows() -> list[Row]:
    errors = _radial_errors()
    free = "mean angle of the background, fitted on Object 1's weighted average; distances; filled share"
    guess = guesses("weighted average")
    cells = (
        (2, "weighted average", "weighted average", "weighted average",
         "within the tolerance, but so are the same length as for Object 1 "
         f"({guess['same length']:.2f} %) and the same percentage ({guess['same percentage']:.2f} %): no power"),
        (1, "proposed", "proposed as printed (÷ cos, r³/r²)", "printed", "without an offset, ÷ cos doubles the error"),
        (2, "proposed", "proposed as printed (÷ cos, r³/r²)", "printed", "without an offset, ÷ cos doubles the error"),
        (1, "proposed", "proposed with the cosine multiplied", "×cos", "r³/r² remains: 2σ²(1/z_b − 1/z_o)"),
        (2, "proposed", "proposed with the cosine multiplied", "×cos", "r³/r² remains: 2σ²(1/z_b − 1/z_o)"),
    )  # fmt: skip
    rows = []
    for number, column, what, method, note in cells:
        band = _spread(errors[method][:, number - 1])
        rows.append(_row("radial", number, column, what, band, _judge(number, column, band), note, free))
    return rows


def _length_rows() -> list[Row]:
    """One error of constant length per method, read from Object 1."""
    rows = []
    for column in ("weighted average", "proposed"):
        mm = [10.0 * value * depth for value, depth in zip(PUBLISHED[column], DEPTHS_M, strict=True)]
        guess = guesses(column)
        value = guess["same length"]
        rows.append(_row("same length", 2, column, column, (value, value, value), _judge(2, column, (value, value, value)),
                         f"{mm[0]:.1f} mm for Object 1 and {mm[1]:.1f} mm for Object 2; off by "
                         f"{abs(value - PUBLISHED[column][1]):.2f} points. The same percentage, {guess['same percentage']:g} %, "
                         "is within the tolerance too, so the table cannot tell a length from a share; no cause is named",
                         f"length, read from Object 1's {column}"))  # fmt: skip
    return rows


def _both_rows() -> list[Row]:
    """Both causes at once: Object 1 is fitted, Object 2 is a prediction."""
    both = _combined()
    second = np.abs(both.error2)
    free = "offset B and mean angle θ, fitted on Object 1's two numbers; rig; filled share; signs"
    angle = np.degrees(both.angle_rad)
    how = (
        f"{both.fitted} of {both.tried} rigs and filled shares can be fitted to Object 1 (two parameters, two numbers), with "
        f"offsets of {both.offset.min():.3f} … {both.offset.max():.3f} (median {np.median(both.offset):.3f}) of the echo's "
        f"peak and mean angles of {angle.min():.0f} … {angle.max():.0f}° (median {np.median(angle):.0f}°)"
    )
    cells = (("weighted average", "weighted average"), ("proposed", "proposed as printed (÷ cos, r³/r²)"))
    rows = []
    for k, (column, what) in enumerate(cells):
        band = _spread(second[:, k])
        near = np.abs(second[:, k] - PUBLISHED[column][1]) <= _tolerance(2)
        rows.append(_row("both", 2, column, what, band, _judge(2, column, band),
                         f"{second.shape[0]} fits; {100 * float(near.mean()):.0f} % within the tolerance; {how}",
                         free))  # fmt: skip
    return rows


@lru_cache(maxsize=1)
def _combined() -> Fits:
    return fits(*(PUBLISHED[column][0] / 100.0 for column in ("weighted average", "proposed")))


def shares() -> dict[str, tuple[int, int]]:
    """(rigs or fits that meet all four numbers within the tolerance, rigs or fits in all) by reading, nothing refitted."""
    _, offset = _offset_errors()
    radial, both = _radial_errors(), _combined()
    found = {
        "offset": (offset["weighted average"], offset["r³/r²"]),
        "offset, 10 % threshold": (offset["weighted average"], offset["r³/r² over 10 %"]),
        "radial": (radial["weighted average"], radial["printed"]),
        "both": tuple(np.stack([both.error1[:, k], both.error2[:, k]], axis=-1) for k in (0, 1)),
    }
    result = {}
    for reading, cells in found.items():
        met = [np.abs(np.abs(cell) - PUBLISHED[column]) <= PUBLISHED["set-up"]
               for column, cell in zip(("weighted average", "proposed"), cells, strict=True)]  # fmt: skip
        result[reading] = (int(np.sum(np.all(met, axis=(0, 2)))), len(cells[0]))
    return result


def _share_rows() -> list[Row]:
    notes = {
        "offset": "r³/r² without the cosine of Eq. 24, so this reading does not test Eq. 24 as printed",
        "offset, 10 % threshold": "the proposed model keeps samples over 10 % of the brightest, the weighted average all: one "
        "fitted parameter gives the table in a larger share of rigs than the two of «both»",
        "radial": "Eq. 24 as printed, no offset",
        "both": f"Eq. 24 as printed: with two free parameters it can give the table, {_example()}, but need not. The share of "
        "our grid that does is not a probability, since the rig is unknown",
    }
    free = {
        "offset": "offset B; rig", "offset, 10 % threshold": "offset B; threshold; rig",
        "radial": "mean angle θ; distances; filled share",
        "both": "offset B and mean angle θ; rig; filled share; signs",
    }  # fmt: skip
    return [
        Row("Table 1", f"share of cases that meet all four numbers within the tolerance, reading «{reading}»", "1", math.nan,
            met / count, math.nan, "undetermined" if met else "contradicted", f"{met} of {count}; {notes[reading]}",
            free[reading])
        for reading, (met, count) in shares().items()
    ]  # fmt: skip


def _example() -> str:
    """The fit nearest to the two numbers of Object 2."""
    both = _combined()
    off = np.abs(both.error2) - [PUBLISHED[column][1] for column in ("weighted average", "proposed")]
    i = int(np.argmin(np.sum(off**2, axis=1)))
    return (f"e.g. B = {both.offset[i]:.3f} and θ = {math.degrees(both.angle_rad[i]):.0f}° give "
            f"{abs(both.error2[i, 0]):.1f} and {abs(both.error2[i, 1]):.1f} % for Object 2")  # fmt: skip
