"""What the twin of a pulsed ranger is compared in."""

from __future__ import annotations

from .clause import Clause
from .shared_clauses import NO_SOURCE, RANGE, RESIDUAL, precise, true_of

__all__ = ["CLAUSES"]

_MORE = "shots"

CLAUSES = (
    Clause(
        "offset", "Level before the echo", "DN", 1.0, 0.0, 0.5, "half a count", "EMVA 1288 R4.0, dark frames, in spirit",
        "offset apart from dark current and ambient light: all are in these samples",
        "the twin's offset, dark current or ambient light is wrong", more=_MORE,
    ),
    Clause(
        "noise", "Noise before the echo: temporal rms of a sample", "DN", 1.0, 0.05, 0.0,
        "5 %: half of a planted error of 10 %", "EMVA 1288 R4.0, dark frames, in spirit",
        "read noise apart from that of dark current and ambient light; its correlation along the record",
        "the twin's read noise, dark current or ambient light is wrong", more=_MORE,
    ),
    Clause(
        "gain", "Variance per mean in the echo", "DN", 1.0, 0.05, 0.0, "5 %", "EMVA 1288 R4.0, photon transfer, in spirit",
        "gain apart from excess noise; what all samples of a shot share is taken out",
        "the twin's detector gives another variance for the same light: its gain or excess noise is wrong", more=_MORE,
    ),
    Clause(
        "fluctuation", "Energy of shots: relative rms beyond noise", "%", 100.0, 0.0, 0.5, "half a percent of a shot's light",
        NO_SOURCE, "whether the energy of the laser or the target's response varies",
        "the real laser varies from shot to shot otherwise than the twin's", more=_MORE,
    ),
    Clause(
        "pulse", "Width of the mean echo at half its height", "ns", 1e9, 0.025, 0.0, "2.5 %: half of a planted error of 5 %",
        NO_SOURCE, "which of pulse, detector and the target's depth is wrong; the tail: see the residual",
        "the twin's pulse or response is too short or too long, or its target is deeper or less deep", more=_MORE,
    ),
    Clause(
        "t0", "Time of the mean echo: middle at half its height", "ps", 1e12, 0.0, 20.0, "20 ps: 3 mm of range in air",
        NO_SOURCE, "an error of the surveyed distance, or of the index, which shifts likewise",
        "the twin's zero of time, index or target distance is wrong", more=_MORE,
    ),
    RESIDUAL,
    precise("Range precision of waveform-ml: rms over shots", "mm", 1e3, _MORE),
    true_of("Range trueness of waveform-ml: mean error", "mm", 1e3, 3.0, "3 mm: 20 ps in air", RANGE, _MORE),
)  # fmt: skip
