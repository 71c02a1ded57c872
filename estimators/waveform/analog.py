"""Analog records in photoelectrons, also where the rig states gain, read noise or limits of the converter as unknown."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..rig import DeclaredRig

__all__ = ["AnalogSamples", "read_analog"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

_PLACE = "detector.readout"
#: The quantile of a normal distribution one standard deviation below its median.
_ONE_BELOW = 0.158655


class AnalogSamples(NamedTuple):
    """z (shot, sample): light above the offset; good (likewise): finite, not clipped, not dead; clipped (shot). A sample of mean
    μ has the variance excess·μ + floor_var.

    z is in photoelectrons; where the gain is unknown it is in standard deviations of the baseline, and excess is 0 (to be
    measured: `light_noise`).
    """

    z: Float
    good: Bool
    clipped: Bool
    excess: float
    floor_var: float


def read_analog(rig: DeclaredRig, raw: npt.NDArray[Any], used: Bool) -> AnalogSamples:
    """Samples (shot, sample) in the unit of the signal to light.

    used (shot): shots that show the noise of the baseline, where the declared rig does not. Raises InputError for a rig that
    lacks a value or states one as unknown that is needed.
    """
    finite = np.isfinite(raw)
    top = _flat_top(raw) if rig.unknown(f"{_PLACE}.adc_bits") else None
    if rig.unknown(f"{_PLACE}.gain_dn_per_e"):
        offset = rig.number(f"{_PLACE}.offset_dn")
        _, noise = _baseline(raw, used)
        unit = noise if noise > 0 else _least_step(raw) / np.sqrt(12)
        saturation = 2.0 ** rig.whole(f"{_PLACE}.adc_bits", most=53) - 1 if top is None else top
        dead = 0.0 if offset > 8 * unit else -np.inf
        scale, excess, floor = unit, 0.0, 1.0
    else:
        tube = rig.amplifier(f"{_PLACE}.avalanche")
        read = None
        if rig.unknown(f"{_PLACE}.read_noise_e"):
            gain, offset = rig.number(f"{_PLACE}.gain_dn_per_e", above=0), rig.number(f"{_PLACE}.offset_dn")
            level, noise = _baseline(raw, used)
            light = max(level - offset, 0.0) / (gain * tube.gain)
            read = float(np.sqrt(max((noise**2 - 1 / 12) / gain**2 - tube.excess * tube.gain**2 * light, 0.0)))
        converter = rig.converter(_PLACE, read_noise_e=read, top_dn=top)
        offset, saturation, dead = converter.offset_dn, converter.saturation_dn, converter.dead_dn
        scale, excess, floor = converter.gain_dn_per_e * tube.gain, tube.excess, converter.floor_e2 / tube.gain**2
    clipped = np.asarray((raw >= saturation).any(axis=1))
    good = finite & (raw < saturation) & (raw > dead)
    z = (np.where(finite, raw, offset).astype(np.float64) - offset) / scale
    return AnalogSamples(z, good, clipped, excess, floor)


def _baseline(raw: npt.NDArray[Any], used: Bool) -> tuple[float, float]:
    """(level, standard deviation) of the darker half of the records, medians over the shots: σ is the distance of the median
    of a record from its quantile .1587. Echoes raise the bright half; they change this only where they fill a fifth of it."""
    held = np.where(np.isfinite(raw), raw, np.nan).astype(np.float64)
    rows = used & np.isfinite(held).any(axis=1)
    if not rows.any():
        return 0.0, 0.0
    low, middle = np.nanquantile(held[rows], (_ONE_BELOW, 0.5), axis=1)
    return float(np.median(middle)), float(np.median(middle - low))


def _least_step(raw: npt.NDArray[Any]) -> float:
    """The least distance of two values; 1 where all are equal."""
    steps = np.diff(np.unique(raw[np.isfinite(raw)]).astype(np.float64))
    return float(steps.min()) if steps.size else 1.0


def _flat_top(raw: npt.NDArray[Any]) -> float:
    """The largest value, if two neighbouring samples of a shot have it; else inf."""
    finite = raw[np.isfinite(raw)]
    if not finite.size:
        return float("inf")
    top = raw == finite.max()
    return float(finite.max()) if (top[:, 1:] & top[:, :-1]).any() else float("inf")
