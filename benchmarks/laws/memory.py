"""Laws against memory: other data have their own answer, a declared rig is read anew, and no capture changes the next one's answer.

An estimator that keeps its last answer, or one by its data or its rig, is honest on the first capture and wrong, or faster than it
is, on the next. The runner gives repeated calls other noise, and each condition another process; these laws show an author why an
answer is refused there.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runner.sealed import fresh, stale
from .maker import Answer, Maker, Run

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["no_state", "own_answers", "own_rig"]

#: Factors of what the other rig declares: the gain of the converter, and every refractive index of the medium.
_GAIN, _INDEX = 1.25, 1.02
#: Relative difference of standard errors, and difference of values in standard errors, that other noise of ±1 DN may make in the
#: median of a capture's elements. Read from the wrong rig, sigma is off by a tenth or more, or ranges by 2 %.
_SIGMA, _VALUE = 0.05, 1.0
#: Relative difference of the answers to a capture before and after others: none but for the order of sums.
_RTOL = 1e-7


def own_answers(run: Run, maker: Maker) -> str:
    """Other noise of the same light does not have the same answers, bit by bit, as the capture before."""
    first, second = (_numbers(run(capture)) for capture in (maker.clean(), _noisier(maker, 1)))
    return "The answers to other data are those to the data before." if stale(first, second) else ""


def own_rig(run: Run, maker: Maker) -> str:
    """The same data under another declared rig have the answers that other noise of the same light has under that rig."""
    rig = _other_rig(maker)
    run(maker.clean())
    same = maker.answers(run(maker.clean().assign_attrs(rig=rig)))
    other = maker.answers(run(_noisier(maker, 2).assign_attrs(rig=rig)))
    for one, two in zip(same, other, strict=True):
        both = one.valid & two.valid
        if not both.any():
            continue
        ratio = float(np.median(np.abs(one.sigma[both] / two.sigma[both] - 1.0)))
        moved = float(np.median(np.abs(one.value[both] - two.value[both]) / two.sigma[both]))
        if ratio > _SIGMA or moved > _VALUE:
            return (
                "Under another declared rig, data that were seen before have other answers than new data: they differ by "
                f"{moved:.2g} sigma, and sigma by {100 * ratio:.2g} %."
            )
    return ""


def no_state(run: Run, maker: Maker) -> str:
    """A capture has the answers after others that it had before them."""
    before = maker.answers(run(maker.clean()))
    for capture in (maker.later()[0], _noisier(maker, 3), maker.later()[0]):
        run(capture)
    after = maker.answers(run(maker.clean()))
    same = all(map(_close, before, after))
    return "" if same else "A capture has other answers after captures than before them."


def _noisier(maker: Maker, seed: int) -> xr.Dataset:
    """The clean capture with every sample changed by −1, 0 or 1 DN; of another seed, data that no law has shown before."""
    name = maker.layout.data
    alter = fresh(name, seed=seed)
    return maker.changed(lambda data: alter(name, [], data))


def _other_rig(maker: Maker) -> str:
    """The declared rig with another gain and other refractive indices."""
    rig: dict[str, Any] = json.loads(json.dumps(maker.rig))
    part = maker.laws.converter(rig)
    if part is not None:
        part["gain_dn_per_e"] *= _GAIN
    medium = rig.get("medium")
    if isinstance(medium, dict):
        for name, value in medium.items():
            if name.endswith("index") and isinstance(value, int | float):
                medium[name] = value * _INDEX
    return json.dumps(rig)


def _numbers(result: xr.Dataset) -> dict[str, np.ndarray]:
    return {str(name): np.asarray(variable.values) for name, variable in result.variables.items()}


def _close(one: Answer, two: Answer) -> bool:
    if not np.array_equal(one.valid, two.valid):
        return False
    value, other = (np.where(one.valid, answer.value, 0.0) for answer in (one, two))
    return bool(np.allclose(value, other, rtol=_RTOL, atol=0.0))
