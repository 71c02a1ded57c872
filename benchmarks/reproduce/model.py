"""Eq. 23, 24 and the errors behind Figure 9 on generated captures of the two objects."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...estimators.gated.tools.stack import read_stack
from .objects import CORNER_RAD, depth_of, mean_shift, objects, printed_average, read
from .rows import Row

__all__ = ["PRINTED", "TIMES_COSINE", "figure_9_points", "model_rows"]

#: Eq. 24 as printed, and with the cosine as a factor; φ is the angle of this camera's corner.
PRINTED = f"chua-2017[phi={CORNER_RAD:.6f}]"
TIMES_COSINE = f"chua-2017-orthogonal[phi={CORNER_RAD:.6f}]"
_FREE = "shapes; reflectivities; rig"


def model_rows() -> list[Row]:
    """Rows of Eq. 23 and 24 from captures."""
    return _equation_24()


def _equation_24() -> list[Row]:
    capture = objects().clean[0]
    lambert = read(capture, f"chua-2017[k_d=1,k_s=0,phi={CORNER_RAD:.6f}]").range
    glossy = read(capture, f"chua-2017[k_d=0.1,k_s=5,phi={CORNER_RAD:.6f},slope=0.1]").range
    cancels = float(np.nanmax(np.abs(glossy / lambert - 1.0)))
    plain, plain_error = mean_shift(capture, read(capture, "weighted-average").range)
    cubic, cubic_error = mean_shift(capture, printed_average(capture))
    alone, _ = mean_shift(capture, printed_average(capture, "truth_electrons"))
    divided, _ = mean_shift(capture, read(capture, PRINTED).range)
    stack = read_stack(capture)
    sigma_m = stack.instrument.m_per_s * math.sqrt(stack.instrument.responses[0].variance_s2)
    truth = capture["truth_range"].values[(capture["truth_material"].values == 1) & ~capture["truth_mixed"].values]
    law = float(np.mean(2.0 * sigma_m**2 / truth))
    secant = float(np.mean(truth * (truth / 5.0 - 1.0)))  # r (secθ − 1) on a wall at 5 m
    mm = 1e3
    return [
        Row("Eq. 23", "change of range when another reflection (Eq. 4) is put in, relative", "1", math.nan, cancels,
            math.nan, "contradicted" if cancels < 1e-9 else "undetermined",
            "the factor is the same for all slices of a pixel and cancels between numerator and denominator: as printed the "
            "model does not compensate reflection. It can act through weights only (radiometric-average)"),
        Row("Eq. 24", "mean error of the background's range, r³/r² without the cosine, clean stack", "mm", math.nan,
            mm * cubic, 3 * mm * cubic_error, "contradicted" if cubic > 3 * cubic_error else "undetermined",
            f"a symmetric echo moves by 2σ²/r = {mm * law:.2f} mm ({alone / law:.3f} of it without noise); a plain weighted "
            f"average errs by {mm * plain:.2f} ± {mm * plain_error:.2f} mm. All slices of a pixel see one surface at one range: "
            "weights that grow with the range of a slice compensate no loss. Reading: the last form of Eq. 24 has r³ in the "
            "denominator too, which would give no range; r² is taken, as in its first form (t³ over t²) and in Eq. 23", _FREE),
        Row("Eq. 24", "mean error of the background's range as printed, ÷ cosθ", "mm", math.nan, mm * divided,
            3 * mm * cubic_error, "contradicted" if divided > 3 * cubic_error else "undetermined",
            f"r(secθ − 1) = {mm * secant:.0f} mm on average: time of flight already measures the radial range. Eq. 10 "
            "multiplies by the cosine to get the orthogonal distance; Eq. 24 divides and leads further from it", _FREE),
    ]  # fmt: skip


def figure_9_points() -> list[dict[str, Any]]:
    """Depth errors in % by capture, method and object."""
    pair = objects()
    methods = {
        "weighted average": ("weighted-average", False),
        "weighted average, radial taken as depth": ("weighted-average", True),
        "proposed as printed, taken as depth": (PRINTED, True),
        "r³/r² without cosine": ("chua-2017[phi=0]", False),
        "r³/r² over 10 %": ("chua-2017[phi=0,threshold=0.1]", False),
        "proposed, cosine multiplied": (TIMES_COSINE, False),
        "weighted average, background subtracted": ("weighted-average[background=outside]", False),
    }
    points = []
    for kind, captures in (("clean", pair.clean), ("with offset", pair.raised)):
        for number, capture in enumerate(captures, start=1):
            true = depth_of(capture, capture["truth_depth"].values)
            for name, (label, as_depth) in methods.items():
                found = read(capture, label, taken_as_depth=as_depth).depth_m
                points.append({"capture": kind, "object": f"Object {number}", "method": name,
                               "error": 100.0 * (found / true - 1.0)})  # fmt: skip
    return points
