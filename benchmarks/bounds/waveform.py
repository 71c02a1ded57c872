"""Cramer-Rao bound of the range of every shot of a waveform capture, amplitude and background profiled.

Sample k has the mean μ_k = α R(τ − t_k + Δ/2) + b, R the correlation of the detected pulse with the sampling interval.
With J_k the information of sample k about its mean and gradients a_k = (α R' · 2n_g/c, R, 1), F = Σ J_k a_k a_kᵀ and
σ² = (F⁻¹)₀₀. Analog samples: J is exact for Poisson ⊗ gamma ⊗ Gaussian ⊗ ADC (`optics.fisher`). Single-photon bins:
n_k ~ Binomial(live_k, 1 − e^(−λ_k)) given the earlier counts, so that the score is a sum of martingale differences and
J_k = E live_k/((e^λ − 1) M²) about μ = Mλ. The echo is that of a point at the true range.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.rig import DeclaredRig
from ...optics import pile_up
from ...optics.constants import C_M_PER_S
from ...optics.correlation import waveforms
from ...optics.correlation.response import Table, lookup, tabulate
from ...optics.likelihood.fisher_table import information_table
from ...optics.likelihood.model import NoiseModel
from ...scenes.medium_index import group_index
from ...scenes.rigs.waveform import (
    AnalogReadout,
    SinglePhotonReadout,
    WaveformRig,
    shared_jitter_s,
    shown_pulse,
    waveform_rig,
)
from ...scenes.scene import Scene
from ..scores.truth import Bound
from .footprint import footprint_std_s, is_wide
from .instrument import bounded, moves, response_std_s, samples_variance_s2, true_scene, true_time, unbounded
from .profiled import profiled_sigma

__all__ = ["analog_noise", "record_start", "waveform_bound"]

Float = npt.NDArray[np.float64]

_RTOL = 3e-6
_LEAST_MEAN = 1e-6


def analog_noise(readout: AnalogReadout) -> NoiseModel:
    """The likelihood of one analog sample."""
    tube = readout.avalanche
    return NoiseModel(
        read_noise_e=readout.read_noise_e,
        gain_dn_per_e=readout.gain_dn_per_e,
        offset_dn=readout.offset_dn,
        adc_max_dn=2**readout.adc_bits - 1,
        full_well_e=readout.full_well_e,
        excess_noise_factor=1.0 if tube is None else tube.excess_noise_factor,
        intensifier_gain=1.0 if tube is None else tube.gain,
    )


def waveform_bound(capture: xr.Dataset) -> Bound:
    """The bound of every shot of a generated waveform capture.

    `kind` is "exact", or "quasi" if energy or timing fluctuate from shot to shot, also if only in the mean of its pulses by more
    than a tenth of a bound, or if the footprint of any shot spreads its echo by more than a tenth of the response. Without
    true scene, amplitude or background it is "none", with scales from the declared rig; so it is for shots with outgoing
    pulses of their own, which no scene holds. Records start at `time` + `start`; samples that are not sound carry no
    information.

    Raises InputError for an invalid true scene, or for a declared rig that lacks a required value.
    """
    if "pulse" in capture or not bounded(capture, "truth_amplitude", "truth_background"):
        return unbounded(capture, lambda rig: _declared_scales(capture, rig))
    scene = true_scene(capture)
    rig = waveform_rig(scene)
    pulse, delay = shown_pulse(rig)
    step = rig.record.step_s
    table = tabulate(pulse, waveforms.RectangularGate(step, 1.0), _RTOL)
    half = C_M_PER_S / (2.0 * group_index(scene.medium, rig.laser.wavelength_m))
    time = true_time(capture, "time", rig.t0_s)
    scale = half * response_std_s([table])
    window = half * (float(time[-1] - time[0]) + step)
    truth = np.asarray(capture["truth_range"].values, np.float64)
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)[:, None]
    background = np.asarray(capture["truth_background"].values, np.float64).reshape(truth.size, -1)
    u = (truth / half + delay - record_start(capture))[:, None] - time + 0.5 * step
    seen = np.isfinite(u)
    share, slope = _share(table, np.where(seen, u, 0.0))
    mean = np.maximum(amplitude * share + background, 0.0)
    gradient = np.stack([amplitude * slope / half, share, np.ones_like(share)])
    information = _information(rig, mean)
    if "valid_sample" in capture:
        information = information * np.asarray(capture["valid_sample"].values, bool)
    sigma = np.where(seen.all(axis=1), profiled_sigma(information, gradient), np.nan)
    drawn = max(rig.laser.energy_fluctuation, rig.laser.jitter_shot_s) > 0 or moves(half * shared_jitter_s(rig), sigma)
    kind = "quasi" if drawn or _is_wide(scene, rig, scale / half) else "exact"
    return Bound(sigma, kind, scale, window)


def record_start(capture: xr.Dataset) -> Float:
    """Start of every record, added to `time` (shot), s."""
    if "start" in capture.variables:
        return np.asarray(capture["start"].values, np.float64)
    return np.zeros(capture.sizes["shot"])


def _is_wide(scene: Scene, rig: WaveformRig, response_s: float) -> bool:
    field = math.atan2(0.5 * rig.detector.active_diameter_m, rig.receiver.focal_length_m)
    reach = rig.record.scan_half_angle_rad
    angle = np.linspace(-reach, reach, rig.record.shots) if rig.record.shots > 1 else np.zeros(1)
    return is_wide(footprint_std_s(scene, rig.laser.illumination, rig.laser.wavelength_m, field, angle), response_s)


def _declared_scales(capture: xr.Dataset, rig: DeclaredRig) -> tuple[float, float]:
    """(scale, window) of the declared response, averaged over one sampling interval."""
    half = C_M_PER_S / (2.0 * rig.number("medium.group_index", above=0))
    time = np.asarray(capture["time"].values, np.float64)
    step = float(np.diff(time).mean()) if time.size > 1 else rig.number("record.step_s", above=0)
    scale = half * math.sqrt(samples_variance_s2(rig.samples("response")) + step**2 / 12.0)
    return scale, half * (float(time[-1] - time[0]) + step)


def _share(table: Table, u: Float) -> tuple[Float, Float]:
    """R(u) and R'(u); the slope by differences of the cubic at a distance of 1e-3 of the table's step."""
    small = 1e-3 * table.step_s
    value = np.asarray(lookup(table, u), np.float64)
    ahead, behind = np.asarray(lookup(table, u + small)), np.asarray(lookup(table, u - small))
    return value, np.asarray((ahead - behind) / (2 * small), np.float64)


def _information(rig: WaveformRig, mean: Float) -> Float:
    """J (shot, sample) of the means of a shot's samples."""
    readout = rig.detector.readout
    if isinstance(readout, SinglePhotonReadout):
        # Without any light J is infinite: below a mean of 1e-6 the error of the background has no effect.
        rate = np.maximum(mean, _LEAST_MEAN) / rig.pulses_per_shot
        dead = pile_up.dead_bins(readout.dead_time_s, rig.record.step_s, rig.record.samples)
        _, live = pile_up.expected_counts(rate, rig.pulses_per_shot, dead)
        return pile_up.count_information(rate, live) / rig.pulses_per_shot**2
    floor = max(float(mean.min()), 1e-4)
    top = max(float(mean.max()), 2 * floor)
    grid = np.linspace(math.log(0.99 * floor), math.log(1.01 * top), 2 + math.ceil(64 * math.log(top / floor)))
    values = np.log(np.maximum(_table(analog_noise(readout))(np.exp(grid)), 1e-300))
    return np.asarray(np.exp(np.interp(np.log(np.maximum(mean, floor)), grid, values)), np.float64)


@lru_cache(maxsize=8)
def _table(noise: NoiseModel):  # type: ignore[no-untyped-def]
    return information_table(noise)
