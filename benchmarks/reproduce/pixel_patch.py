"""Predicted range errors of Kusters 1992: Figures 3.6 and 3.7, and the accuracy of 5 mm at 1 m, by its own Eq. 3.33 to 3.36."""

from __future__ import annotations

import math

import numpy as np

from ...optics.pixel_patch import predicted_error_m
from .rows import Row

__all__ = ["ITEMS", "greatest_error_mm", "pixel_patch_rows"]

_DOCUMENT = "001"
#: Items, as docs/coverage.csv names them.
ITEMS = ("Accuracy of 5 mm at 1 m", "Figure 3.6", "Figure 3.7")
#: The document has no index; that of water to air at 532 nm is 1.33.
_INDEX = 1.33
#: 5 mm is printed with one digit.
_HALF_MM = 0.5


def greatest_error_mm(range_m: float, baseline_m: float = 0.15, angle_deg: float = 10.0) -> float:
    """The predicted greatest error [mm] straight ahead of the laser, of 192 pixels on 11.1 mm and a lens of 25 mm."""
    return 1e3 * float(
        predicted_error_m(
            range_m, pixel_m=11.1e-3 / 192, focal_length_m=25e-3, index=_INDEX, baseline_m=baseline_m,
            angle_rad=float(np.deg2rad(angle_deg)),
        )
    )  # fmt: skip


def pixel_patch_rows() -> list[Row]:
    """The stated accuracy against the prediction; growth with range; the effects of baseline and angle."""
    nan = math.nan
    free = "index 1.33; no aberration"
    one, two = greatest_error_mm(1.0), greatest_error_mm(2.0)
    by_baseline = greatest_error_mm(1.0, 0.1) / greatest_error_mm(1.0, 0.25)
    by_angle = greatest_error_mm(4.0, angle_deg=10.0) / greatest_error_mm(4.0, angle_deg=5.0)
    return [
        Row(
            ITEMS[0], "predicted greatest error at 1 m", "mm", 5.0, one, _HALF_MM,
            "predicted" if abs(one - 5.0) <= _HALF_MM else "contradicted",
            "Eq. 3.33 to 3.36 give more than the stated accuracy before any aberration; the mean error of whole pixels is about "
            "half of it, so that the statement holds for the mean", free, _DOCUMENT,
        ),
        Row(
            ITEMS[1], "error at 2 m over that at 1 m", "1", nan, two / one, nan, "trend" if two > 3 * one else "contradicted",
            "nearly with the square of the range; no value is printed", free, _DOCUMENT,
        ),
        Row(
            ITEMS[2], "error with a baseline of 100 mm over that with 250 mm, at 1 m", "1", nan, by_baseline, nan,
            "trend" if by_baseline > 1 else "contradicted", "nearly as 1/b; no value is printed", free, _DOCUMENT,
        ),
        Row(
            ITEMS[2], "error with the camera at 10 degrees over that at 5 degrees, at 4 m", "1", nan, by_angle, 0.01,
            "trend" if abs(by_angle - 1) <= 0.01 else "contradicted",
            "the text: changing the camera angle has no effect on the range-error performance", free, _DOCUMENT,
        ),
    ]  # fmt: skip
