"""What the twin of a laser line is compared in."""

from __future__ import annotations

from .clause import Clause
from .shared_clauses import NO_SOURCE, RESIDUAL, RESIDUAL_SPREAD, precise

__all__ = ["CLAUSES"]

CLAUSES = (
    Clause(
        "offset", "Dark level", "DN", 1.0, 0.0, 0.3, "0.3 DN: a third of a count", "EMVA 1288 R4.0, dark frames",
        "offset apart from dark current and ambient light: both are in these frames",
        "the twin's offset, dark current or ambient light is wrong", more="frames",
    ),
    Clause(
        "read-noise", "Dark noise: temporal rms of a pixel", "DN", 1.0, 0.05, 0.0, "5 %: half of a planted error of 10 %",
        "EMVA 1288 R4.0, dark frames", "noise that differs between pixels, and its correlation",
        "the twin's read noise or dark current is wrong", more="frames",
    ),
    Clause(
        "gain", "Photon transfer: variance per mean in the line", "DN", 1.0, 0.05, 0.0, "5 %",
        "EMVA 1288 R4.0, photon transfer, in spirit", "gain apart from excess noise; what all pixels of a frame share is taken out",
        "the twin's detector gives another variance for the same light", more="frames",
    ),
    Clause(
        "width", "Width of the line: rms across it", "px", 1.0, 0.025, 0.0, "2.5 %: half of a planted error of 5 %", NO_SOURCE,
        "which of the lens, the focus of the laser and its divergence is wrong",
        "the twin's lens, waist or divergence is wrong", more="frames",
    ),
    Clause(
        "evenness", "Light along the line: relative rms about the twin's", "%", 100.0, 0.0, 1.0, "1 % of the light of a row",
        NO_SOURCE, "the fan of the laser apart from albedo, water and vignetting",
        "the real light along the line differs from the scene's: the fan, the albedo or the vignetting", more="frames",
    ),
    Clause(
        "place", "Place of the line: mean of the columns' errors", "px", 1.0, 0.0, 0.05, "0.05 px", NO_SOURCE,
        "which of target, baseline, port and plane of the laser is wrong",
        "the twin's camera, port, plane of the laser or target distance is wrong", more="frames",
    ),
    Clause(
        "shape", "Shape of the line: rms of the columns' errors about their mean", "px", 1.0, 0.0, 0.03, "0.03 px", NO_SOURCE,
        "unevenness of the target apart from distortion of the lens",
        "the twin's distortion, port or tilt, or the target's shape is wrong", more="frames",
    ),
    RESIDUAL,
    RESIDUAL_SPREAD,
    precise("Precision of line-erf: rms of a row's column over frames", "px", 1.0, "frames"),
)  # fmt: skip
