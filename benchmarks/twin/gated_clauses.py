"""What a gated twin is compared in: each clause with its tolerance, the test that it follows, and what it cannot show."""

from __future__ import annotations

from .clause import Clause

__all__ = ["CLAUSES"]

_EMVA = "EMVA 1288 R4.0, photon transfer"
_DARK = "EMVA 1288 R4.0, dark frames"
_RANGE = "in the manner of ASTM E3125 (errors against a reference of lower uncertainty); not that test: its artefacts are not here"
_NO_SOURCE = ""

CLAUSES = (
    Clause(
        "gain", "Photon transfer: variance per mean (gain × excess noise)", "DN", 1.0, 0.015, 0.0,
        "1.5 %: bounds and stated sigmas then err by 0.8 %", _EMVA,
        "gain apart from excess noise: see the next clause; noise that all pixels of a frame share is taken out",
        "the twin's detector gives another variance for the same light: its gain × F² is wrong",
    ),
    Clause(
        "excess", "Excess noise factor F², by the third cumulant", "1", 1.0, 0.0, 0.5,
        "0.5: a tube of F² = 1.8 is told from none; sigmas err by 15 %", _NO_SOURCE,
        "more than the first three moments of the tube's pulses; a phosphor that spreads light over pixels lowers it",
        "the twin's amplification is of another randomness: an intensifier is left out, or its F² is wrong",
    ),
    Clause(
        "fluctuation", "Light of whole frames: relative rms beyond noise", "%", 100.0, 0.0, 0.5,
        "half a percent of the light of a frame", _NO_SOURCE, "whether the energy or the delay of the pulses varies",
        "the real laser varies from frame to frame otherwise than the twin's",
    ),
    Clause(
        "offset", "Dark level", "DN", 1.0, 0.0, 0.3, "0.3 DN: a third of a count", _DARK,
        "offset apart from dark current and ambient light: both are in these frames",
        "the twin's offset, dark current or ambient light is wrong",
    ),
    Clause(
        "read-noise", "Dark noise: temporal rms of a pixel", "DN", 1.0, 0.05, 0.0, "5 %: half of a planted error of 10 %", _DARK,
        "noise that differs between pixels, and its correlation", "the twin's read noise or dark current is wrong",
    ),
    Clause(
        "dsnu", "Dark pattern: rms of the pixels' means", "DN", 1.0, 0.15, 0.1, "15 %, but not below 0.1 DN", "EMVA 1288 R4.0, DSNU",
        "how the pattern is arranged (rows, columns)", "the twin's pixels differ more or less than the real ones",
    ),
    Clause(
        "prnu", "Pattern under light: relative rms of the pixels", "%", 100.0, 0.0, 0.5, "half a percent of the light",
        "EMVA 1288 R4.0, PRNU (there with even light; here against the scene's)", "pattern of the pixels apart from uneven light or albedo",
        "the real light or albedo is less even than the scene's, or the pixels' response",
    ),
    Clause(
        "pulse", "Length of the pulse, relative to the twin's", "1", 1.0, 0.025, 0.0, "2.5 %: half of a planted error of 5 %", _NO_SOURCE,
        "another shape of the pulse: its length is fitted, and residuals show the shape",
        "the twin's pulse is too short or too long",
    ),
    Clause(
        "gate", "Length of the gate, relative to the twin's", "1", 1.0, 0.025, 0.0, "2.5 %", _NO_SOURCE,
        "another shape of the gate; differences between pixels", "the twin's gate is too short or too long",
    ),
    Clause(
        "response", "Length of the response (pulse and gate together)", "1", 1.0, 0.02, 0.0, "2 %", _NO_SOURCE,
        "which of pulse and gate is wrong", "the twin's pulse or gate is too short or too long",
    ),
    Clause(
        "t0", "Zero of time: common shift of the echo", "ps", 1e12, 0.0, 10.0, "10 ps: 1.5 mm of range in air", _NO_SOURCE,
        "an error of the surveyed ranges, or of the index, which shifts likewise", "the twin's zero of time, index or target distance is wrong",
    ),
    Clause(
        "backscatter", "Light before the echo (what the water scatters back)", "electron", 1.0, 0.2, 0.02,
        "20 %, but not below 0.02 electrons a pixel and frame", _NO_SOURCE,
        "what is scattered at later delays, under the echo", "the twin's water scatters back more or less: backscatter is left out or wrong",
    ),
    Clause(
        "residual", "χ² of a pixel per degree of freedom, mean", "1", 1.0, 0.0, 0.15, "0.15: a misfit of 0.4 standard errors", _NO_SOURCE,
        "what a fitted amplitude of each pixel takes up", "the twin's expectation does not explain the counts: shape, place or noise is wrong",
    ),
    Clause(
        "residual-spread", "χ² of a pixel, 95th percentile", "1", 1.0, 0.15, 0.0, "15 %", _NO_SOURCE,
        "which pixels are unlike", "some pixels follow another model: gate differences, edges, dirt",
    ),
    Clause(
        "precision", "Range precision of poisson-ml: rms over repeats", "mm", 1e3, 0.1, 0.0, "10 %",
        "VDI/VDE 2634 in spirit only: repeatability of a single point", "errors that repeats share",
        "compare with the bound: if the twin is at the bound and the rig above it, the rig has noise that the twin lacks; "
        "if both are above it alike, it is the algorithm",
    ),
    Clause(
        "trueness", "Range trueness of poisson-ml: mean error", "mm", 1e3, 0.0, 1.5, "1.5 mm: 10 ps in air", _RANGE,
        "errors that depend on the place in the image cancel in the mean",
        "beyond the bound of a mean: a shift in time or scale that the twin lacks, not noise and not the algorithm, which is the same in both",
    ),
    Clause(
        "flying", "Flying pixels: share of edge pixels with ranges between the surfaces", "1", 1.0, 0.0, 0.1, "0.1", _NO_SOURCE,
        "edges of other contrast", "light is shared otherwise between the surfaces at an edge: the lens or the edge differs",
    ),
    Clause(
        "separability", "Two surfaces: share of edge pixels in which both are found", "1", 1.0, 0.0, 0.1, "0.1", _NO_SOURCE,
        "gaps and contrasts that the scene does not hold", "two surfaces are told apart less or more often than the twin predicts",
    ),
    Clause(
        "ranking", "Ranking of estimators on the twin against that on the rig (Kendall's τ)", "1", 1.0, 0.0, 0.0,
        "above 0: better than chance", _NO_SOURCE, "estimators that were not compared, and other targets",
        "the twin ranks the estimators otherwise than the rig does", above=True,
    ),
)  # fmt: skip
