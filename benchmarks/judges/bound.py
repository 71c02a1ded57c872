"""Truth and bounds of captures of every scored modality."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.layouts import layout_of
from ...scenes.errors import InputError
from ..bounds.instrument import true_scene
from ..bounds.regular import Form, regular, with_threshold
from ..bounds.scan import Elements, Scan
from ..bounds.threshold import ThresholdTable, table_of
from ..scores.truth import Bound, Truth
from . import judge_of

__all__ = [
    "bound_of", "bounds_of", "cramer_rao_bound", "elements_of", "is_regular", "scan_of", "threshold_bound",
    "threshold_table", "truth_of", "truths_of",
]  # fmt: skip


def truths_of(capture: xr.Dataset) -> Mapping[str, Truth]:
    """The truth of every quantity. Raises InputError for a modality that is not scored."""
    return judge_of(capture.attrs.get("modality")).truth(capture)


def truth_of(capture: xr.Dataset) -> Truth:
    """The truth of the main quantity. Raises InputError as `truths_of`."""
    return truths_of(capture)[_first(capture)]


def bounds_of(capture: xr.Dataset) -> Mapping[str, Bound]:
    """The bound of every quantity: if all elements are regular, Cramér-Rao with kind "exact" or "quasi"; otherwise the
    Bayesian bound in the irregular ones, kind "bayes". Depends on rig and truth only, not on any estimate.

    Raises InputError for a modality that is not scored.
    """
    judge = judge_of(capture.attrs.get("modality"))
    bounds = judge.bound(capture)
    if judge.scan is None:
        return bounds
    first = _first(capture)
    return {**bounds, first: threshold_bound(capture, bounds[first])}


def bound_of(capture: xr.Dataset) -> Bound:
    """The bound of the main quantity. Raises InputError as `bounds_of`."""
    return bounds_of(capture)[_first(capture)]


def cramer_rao_bound(capture: xr.Dataset) -> Bound:
    """The Cramér-Rao bound of the main quantity, for regular and irregular elements. Raises InputError as `bounds_of`."""
    return judge_of(capture.attrs.get("modality")).bound(capture)[_first(capture)]


def _first(capture: xr.Dataset) -> str:
    return layout_of(capture.attrs.get("modality")).stages[0].gives[0].name


def elements_of(capture: xr.Dataset) -> tuple[Scan, Elements]:
    """The scan of a generated capture and its elements.

    Raises InputError if it lacks its true scene or amplitudes, or if the threshold of its modality is unknown.
    """
    scan = judge_of(capture.attrs.get("modality")).scan
    if scan is None:
        raise InputError(
            "The threshold of such captures is unknown.", where="modality", value=capture.attrs.get("modality")
        )
    return scan(capture, true_scene(capture))


def scan_of(capture: xr.Dataset) -> Scan:
    """The scan of a generated capture. Raises InputError as `elements_of`."""
    return elements_of(capture)[0]


def threshold_table(capture: xr.Dataset) -> ThresholdTable:
    """The table of a generated capture's rig, shared by all captures with equal rig, delays and shape of the background.

    Raises InputError as `elements_of`.
    """
    return table_of(scan_of(capture))


def is_regular(capture: xr.Dataset, table: ThresholdTable | None = None) -> npt.NDArray[np.bool_]:
    """Flags of the elements of a generated capture, in the shape of its truth: True where the Cramér-Rao bound can be reached.

    Raises InputError as `elements_of`.
    """
    return regular(*elements_of(capture), table)


def threshold_bound(
    capture: xr.Dataset, bound: Bound, table: ThresholdTable | None = None, *, form: Form = "bayes"
) -> Bound:
    """`bound` of a capture's main quantity, replaced in irregular elements; see `with_threshold`.

    A bound of kind "none" is returned unchanged. Raises InputError as `elements_of`.
    """
    if bound.kind == "none":
        return bound
    return with_threshold(bound, *elements_of(capture), truth_of(capture).mixed, table, form=form)
