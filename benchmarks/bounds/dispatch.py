"""The bound of a capture of any modality that has one."""

from __future__ import annotations

import xarray as xr

from ...scenes.errors import InputError
from ..scores.score import Bound

__all__ = ["SCORED", "bound_of", "cramer_rao_bound"]

#: Modalities whose range estimates are scored.
SCORED = ("gated", "waveform", "amcw")


def cramer_rao_bound(capture: xr.Dataset) -> Bound:
    """`gated_bound`, `waveform_bound` or `amcw_bound`. Raises InputError for another modality."""
    modality = capture.attrs.get("modality")
    if modality == "gated":
        from .gated import gated_bound

        return gated_bound(capture)
    if modality == "waveform":
        from .waveform import waveform_bound

        return waveform_bound(capture)
    if modality == "amcw":
        from .amcw import amcw_bound

        return amcw_bound(capture)
    raise InputError(
        "This version does not score such captures.", where="modality", value=modality, allowed=", ".join(SCORED)
    )


def bound_of(capture: xr.Dataset) -> Bound:
    """The Cramér-Rao bound, kind "exact" or "quasi", where all elements are regular; else with the Bayesian bound in
    those that are not, kind "bayes". Decided from rig and truth, before anything is estimated."""
    from .regular import threshold_bound

    return threshold_bound(capture, cramer_rao_bound(capture))
