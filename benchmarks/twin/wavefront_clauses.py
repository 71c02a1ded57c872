"""What the twin of a lenslet camera is compared in."""

from __future__ import annotations

from .clause import Clause
from .shared_clauses import NO_SOURCE, RESIDUAL, RESIDUAL_SPREAD

__all__ = ["CLAUSES"]

_REFERENCE = "exposures of the reference"


def _place(axis: str, name: str) -> Clause:
    return Clause(
        f"place-{axis}", f"Place of the reference's spots: mean distance from the declared ones along {name}", "px", 1.0, 0.0, 0.05,
        "0.05 px", NO_SOURCE, "a shift of the array apart from a tilt of the flat wavefront",
        "the twin's array lies elsewhere on the chip: register the lenslets again", more=_REFERENCE,
    )  # fmt: skip


CLAUSES = (
    Clause(
        "offset", "Level between the spots", "DN", 1.0, 0.0, 0.3, "0.3 DN: a third of a count", "EMVA 1288 R4.0, dark frames",
        "offset apart from dark current, ambient light and the spots' wings",
        "the twin's offset, dark current or ambient light is wrong",
        more="frames",
    ),
    Clause(
        "read-noise", "Noise between the spots: temporal rms of a pixel", "DN", 1.0, 0.05, 0.0,
        "5 %: half of a planted error of 10 %", "EMVA 1288 R4.0, dark frames", "noise that differs between pixels",
        "the twin's read noise or dark current is wrong", more="frames",
    ),
    Clause(
        "width", "Width of the reference's spots: rms per axis", "px", 1.0, 0.025, 0.0, "2.5 %: half of a planted error of 5 %",
        NO_SOURCE, "focus of the lenslets apart from their aberrations",
        "the twin's lenslets have another focal length, fill or focus", more=_REFERENCE,
    ),
    Clause(
        "width-frames", "Width of the frames' spots: rms per axis", "px", 1.0, 0.03, 0.0, "3 %", NO_SOURCE,
        "turbulence within a lenslet apart from the lenslets", "the real spots are wider or narrower than the twin's",
        more="frames",
    ),
    _place("x", "columns"),
    _place("y", "rows"),
    Clause(
        "scale", "Pitch of the reference's spots, relative to the declared one", "%", 100.0, 0.0, 0.1, "0.1 %", NO_SOURCE,
        "an error of the pitch apart from a curved reference wavefront",
        "the twin's pitch, pixel or magnification is wrong, or the flat wavefront is curved", more=_REFERENCE,
    ),
    Clause(
        "evenness", "Light of the reference's spots: relative rms over lenslets", "%", 100.0, 0.0, 3.0, "3 % of a spot's light",
        NO_SOURCE, "where the light is uneven", "the twin's beam or pupil is lit otherwise", more=_REFERENCE,
    ),
    Clause(
        "fluctuation", "Light of whole frames: relative rms", "%", 100.0, 0.0, 1.0, "1 % of a frame's light", NO_SOURCE,
        "the laser's energy apart from scintillation", "the real light varies from frame to frame otherwise", more="frames",
    ),
    Clause(
        "motion", "Motion of a spot from frame to frame: rms per axis", "px", 1.0, 0.1, 0.0, "10 %", NO_SOURCE,
        "noise apart from turbulence and vibration: a wavefront that stands still shows the precision of a centroid",
        "the twin's noise, turbulence or platform is wrong", more="frames",
    ),
    RESIDUAL,
    RESIDUAL_SPREAD,
)  # fmt: skip
