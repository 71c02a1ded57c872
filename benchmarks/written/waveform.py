"""Waveform captures from closed forms: sample k of a shot has the mean α R(2 n_g r/c − t_k + Δ/2) + b photoelectrons.

R is the correlation of the pulse, as the detector shows it, with the sampling interval Δ. Analog samples pass the chain of
`NoiseModel`. A single-photon detector counts n_k ~ Binomial(live_k, 1 − exp(−λ_k)), λ_k the mean of one pulse and live_k
the pulses that no earlier count has blinded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.build import make_capture
from ...optics import pile_up
from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...optics.correlation.waveforms import RectangularGate
from ...scenes.declared import declared_rig
from ...scenes.medium_index import group_index
from ...scenes.rigs.waveform import SinglePhotonReadout, WaveformRig, shown_pulse, waveform_rig
from ...scenes.scene import Scene
from ..bounds.waveform import analog_noise
from .draw import drawn_counts, generator, truth_attributes

__all__ = ["written_capture"]

Float = npt.NDArray[np.float64]


def written_capture(
    scene: Scene, amplitude: Any, background: float, range_m: Any, *, seed: int | None = None, **attrs: Any
) -> xr.Dataset:
    """A waveform capture with its truth, for the rig of `scene` and any range and amplitude of each shot.

    Main arguments:
        amplitude (shot) or a number: photoelectrons of the whole echo, all pulses of the shot together. background:
        photoelectrons of a sample, dark electrons included. range_m (shot), m, or a number.
    Other arguments:
        seed: of the samples; None leaves them zero, which is enough for bounds. attrs: more attributes.

    Raises InputError for a scene of another modality.
    """
    rig = waveform_rig(scene)
    record, (pulse, lag) = rig.record, shown_pulse(rig)
    ranges, light = (np.broadcast_to(np.asarray(v, np.float64), (record.shots,)).copy() for v in (range_m, amplitude))
    tau = 2.0 * group_index(scene.medium, rig.laser.wavelength_m) / C_M_PER_S * ranges
    setting = record.start_s + record.step_s * np.arange(record.samples)
    table = correlation.tabulate(pulse, RectangularGate(record.step_s, 1.0), 1e-6)
    share = correlation.lookup(table, (tau + lag - rig.t0_s)[:, None] - setting + 0.5 * record.step_s)
    mean = light[:, None] * np.maximum(share, 0.0) + background
    signal = np.zeros(mean.shape, np.uint16) if seed is None else _drawn(mean, rig, generator(seed))
    declared = declared_rig(scene)
    return make_capture(
        "waveform",
        data={"signal": signal},
        coords={
            "time": setting + declared["t0_s"], "pulses": np.full(record.shots, rig.pulses_per_shot, np.int32),
            "laser_on": True, "valid": True,
        },
        truth={
            "truth_range": ranges, "truth_amplitude": light, "truth_background": np.full(record.shots, float(background)),
        },
        attrs=truth_attributes(scene, declared) | attrs,
    )  # fmt: skip


def _drawn(mean: Float, rig: WaveformRig, rng: np.random.Generator) -> npt.NDArray[np.uint16]:
    """Samples (shot, sample) of mean photoelectrons."""
    readout, pulses = rig.detector.readout, rig.pulses_per_shot
    if not isinstance(readout, SinglePhotonReadout):
        return drawn_counts(mean, analog_noise(readout), rng)
    dead = pile_up.dead_bins(readout.dead_time_s, rig.record.step_s, rig.record.samples)
    counts = np.zeros(mean.shape, np.int64)
    for k in range(mean.shape[1]):
        live = pulses - counts[:, max(k - dead, 0) : k].sum(axis=1)
        counts[:, k] = rng.binomial(live, -np.expm1(-mean[:, k] / pulses))
    return counts.astype(np.uint16)
