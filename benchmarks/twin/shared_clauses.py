"""Clauses that rendered twins of several kinds are compared in."""

from __future__ import annotations

from .clause import Clause

__all__ = ["NO_SOURCE", "precise", "RANGE", "RESIDUAL", "RESIDUAL_SPREAD", "true_of"]

#: No published test is followed.
NO_SOURCE = ""
RANGE = "in the manner of ASTM E3125 (errors against a reference of lower uncertainty); not that test: its artefacts are not here"

RESIDUAL = Clause(
    "residual", "χ² about the twin's mean per degree of freedom", "1", 1.0, 0.0, 0.15, "0.15: a misfit of 0.4 standard errors",
    NO_SOURCE, "what one fitted factor of the light takes up",
    "the twin's expectation does not explain the counts: shape, place or noise is wrong",
)  # fmt: skip
RESIDUAL_SPREAD = Clause(
    "residual-spread", "χ² of a group of pixels, 95th percentile", "1", 1.0, 0.15, 0.0, "15 %", NO_SOURCE,
    "which pixels are unlike", "some pixels follow another model: edges, dirt, another shape in a part of the image",
)  # fmt: skip


def precise(title: str, unit: str, factor: float, more: str) -> Clause:
    """The clause of precision."""
    return Clause(
        "precision", title, unit, factor, 0.1, 0.0, "10 %", "VDI/VDE 2634 in spirit only: repeatability of a single point",
        "errors that repeats share",
        "compare with the bound: if the twin is at the bound and the rig above it, the rig has noise that the twin lacks; "
        "if both are above it alike, it is the algorithm", more=more,
    )  # fmt: skip


def true_of(title: str, unit: str, factor: float, absolute: float, why: str, follows: str, more: str) -> Clause:
    """The clause of trueness."""
    return Clause(
        "trueness", title, unit, factor, 0.0, absolute, why, follows,
        "errors that depend on the place cancel in the mean; errors of the scene itself",
        "beyond the bound of a mean: a shift in time, place or scale that the twin lacks, not noise and not the algorithm, "
        "which is the same in both", more=more,
    )  # fmt: skip
