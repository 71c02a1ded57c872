"""Captures in which every shot has an outgoing pulse of its own: they are read pulse by pulse."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...scenes.errors import InputError
from ..rig import DeclaredRig, Samples

__all__ = ["outgoing", "per_pulse"]

Float = npt.NDArray[np.float64]
Function = Callable[..., xr.Dataset]


def per_pulse(function: Function) -> Function:
    """A function of a capture that knows one pulse, as one of captures whose shots have pulses of their own (`pulse`).

    Shots of equal pulse are read together, each time with all shots whose laser was off, which show the background. A shot
    whose pulse is not finite, or has no light, has no answer. Captures without `pulse` are passed on.
    """

    @wraps(function)
    def run(capture: xr.Dataset, **params: Any) -> xr.Dataset:
        if "pulse" not in capture.variables:
            return function(capture, **params)
        pulses = np.asarray(capture["pulse"].values, np.float64)
        usable = np.isfinite(pulses).all(axis=1) & (pulses.sum(axis=1) > 0)
        if not usable.any():
            raise InputError(
                "No shot has an outgoing pulse.", where="pulse", value=pulses.shape,
                allowed="finite samples of positive sum in one shot or more",
            )  # fmt: skip
        dark = np.zeros(len(pulses), bool)
        if "laser_on" in capture.variables:
            dark = ~np.asarray(capture["laser_on"].values, bool)
        kinds, which = np.unique(pulses[usable], axis=0, return_inverse=True)
        lit = np.flatnonzero(usable)
        out: xr.Dataset | None = None
        for kind, pulse in enumerate(kinds):
            shots = lit[which.reshape(-1) == kind]
            others = np.setdiff1d(np.flatnonzero(dark), shots)
            part = capture.isel(shot=np.concatenate([shots, others]))
            same = np.broadcast_to(pulse, (part.sizes["shot"], pulse.size))
            found = function(part.assign(pulse=part["pulse"].copy(data=same)), **params)
            out = _empty(found, len(pulses)) if out is None else out
            for name in out.data_vars:
                out[name].values[shots] = found[name].values[: shots.size]
        assert out is not None
        return out

    return run


def _empty(like: xr.Dataset, shots: int) -> xr.Dataset:
    """A result of this many shots without any answer."""
    arrays = {}
    for name, array in like.data_vars.items():
        fill = False if name == "valid" else np.nan
        arrays[name] = (array.dims, np.full((shots, *array.shape[1:]), fill, array.dtype), array.attrs)
    return xr.Dataset(arrays, attrs=like.attrs)


def outgoing(capture: xr.Dataset, rig: DeclaredRig) -> tuple[Samples, float]:
    """(the response to the pulse that all shots of a capture share, its time 0 at the pulse's centroid; that centroid on the
    clock of the records, s).

    The response is the pulse itself, as recorded by the same detector, or its convolution with `detector_response` where the
    rig declares one. Raises InputError where shots have different pulses, or their samples are not evenly spaced.
    """
    pulses = np.asarray(capture["pulse"].values, np.float64)
    time = np.asarray(capture["pulse_time"].values, np.float64)
    if (pulses != pulses[:1]).any():
        raise InputError(
            "The shots of the capture have different outgoing pulses, and this reads one.", where="pulse",
            value=pulses.shape, allowed="one pulse for all shots",
            next_step="put @per_pulse of beambench.estimators.waveform.per_pulse under @estimator",
        )  # fmt: skip
    gaps = np.diff(time)
    if gaps.size == 0 or not gaps.mean() > 0 or (np.abs(gaps - gaps.mean()) > 1e-6 * gaps.mean()).any():
        raise InputError(
            "The samples of the outgoing pulse are not evenly spaced in time.", where="coordinate pulse_time",
            value=float(gaps.mean()) if gaps.size else None, allowed="even, rising steps",
        )  # fmt: skip
    step, value = float(gaps.mean()), pulses[0]
    centroid = float((value * time).sum() / value.sum())
    start = float(time[0]) - centroid
    if rig.get("detector_response") is None:
        return Samples(start, step, value), centroid
    own = rig.samples("detector_response")
    count = int(np.ceil(own.step_s * (own.value.size - 1) / step)) + 1
    kernel = np.interp(step * np.arange(count), own.step_s * np.arange(own.value.size), own.value, right=0.0)
    return Samples(start + own.start_s, step, np.convolve(value, kernel)), centroid
