"""Reading an AMCW capture: samples in photoelectrons, and the phasor of every frequency."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.amcw import modulation_wavelength
from ...optics.constants import C_M_PER_S
from ...scenes.errors import InputError

__all__ = ["AmcwSamples", "Phasors", "phasors", "read_samples"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class AmcwSamples:
    """Samples of all shots, frequencies ascending.

    z (shot, frequency, phase): photoelectrons. good: finite and not clipped. usable (shot): recorded soundly, with the
    laser on. variance of a sample of mean μ: μ + floor_var. t0_s: the reference's lag. window_m: where targets may be.
    """

    z: Float
    good: Bool
    usable: Bool
    frequency_hz: Float
    phase_rad: Float
    group_index: float
    floor_var: float
    t0_s: float
    window_m: tuple[float, float]

    @property
    def m_per_s(self) -> float:
        """Range per unit of travel time, c/(2 n_g)."""
        return C_M_PER_S / (2.0 * self.group_index)

    @property
    def wavelength_m(self) -> Float:
        """Modulation wavelengths (frequency)."""
        return modulation_wavelength(self.frequency_hz, self.group_index)


@dataclass(frozen=True)
class Phasors:
    """(shot, frequency): complex `value` D exp(iω(τ − t₀)), `variance` of its real and of its imaginary part [e²], the
    `phase` ωτ with the declared t₀ taken off [rad], and `sound`: at least three good samples."""

    value: npt.NDArray[np.complex128]
    variance: Float
    phase: Float
    sound: Bool


def read_samples(capture: xr.Dataset) -> AmcwSamples:
    """Read an AMCW capture. Raises InputError where the rig or the samples cannot be used."""
    text = capture.attrs.get("rig")
    try:
        rig = json.loads(text) if isinstance(text, str) else None
    except json.JSONDecodeError as error:
        raise InputError("the declared rig is not JSON", where="attribute rig", value=str(text)[:80]) from error
    if not isinstance(rig, dict) or rig.get("schema") != 1 or rig.get("kind") != "amcw":
        raise InputError("not the declared rig of an AMCW capture", where="attribute rig", allowed="schema 1, amcw")
    if "samples" not in capture or capture["samples"].dims != ("shot", "frequency", "phase"):
        raise InputError("no AMCW samples", where="samples", allowed="dims (shot, frequency, phase)")
    raw = capture["samples"].values
    try:
        detector, window = rig["detector"], rig["range_window_m"]
        gain, offset, read = (float(detector[k]) for k in ("gain_dn_per_e", "offset_dn", "read_noise_e"))
        full = offset + gain * (float(detector["full_well_e"]) - 4 * read)
        top = min(2.0 ** int(detector["adc_bits"]) - 1, full)
        index, t0 = float(rig["medium"]["group_index"]), float(rig["t0_s"])
        declared = np.asarray(rig["modulation"]["frequencies_hz"], np.float64)
        steps = int(rig["modulation"]["phase_steps"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("the declared rig lacks a value", where="attribute rig", value=str(error)) from error
    frequency = np.asarray(capture["frequency"].values if "frequency" in capture.coords else declared, np.float64)
    default = 2 * np.pi * np.arange(steps) / steps
    phase = np.asarray(capture["phase"].values if "phase" in capture.coords else default, np.float64)
    if raw.shape[1:] != (frequency.size, phase.size) or not (frequency > 0).all():
        raise InputError(
            "samples do not fit frequencies and phases", where="samples", value=raw.shape,
            allowed=f"(shot, {frequency.size}, {phase.size})",
        )  # fmt: skip
    order = np.argsort(frequency)
    finite = np.isfinite(raw)
    good = finite & (raw < top)
    z = (np.where(finite, raw, offset).astype(np.float64) - offset) / gain
    usable = np.ones(len(raw), dtype=bool)
    for name in ("valid", "laser_on"):
        if name in capture.variables:
            usable &= np.asarray(capture[name].values, dtype=bool)
    return AmcwSamples(
        z[:, order], good[:, order], usable, frequency[order], phase, index, read**2 + 1 / (12 * gain**2), t0,
        (float(window[0]), float(window[1])),
    )  # fmt: skip


def phasors(samples: AmcwSamples) -> Phasors:
    """Least squares of M + a cos φ + b sin φ for every shot and frequency; D = a + ib.

    With n even phases D = (2/n) Σ z exp(iφ), of variance 2σ²/n in either part. Frequencies with a clipped sample are
    not sound: without it the phases are no longer even, and the bias of the rest would be unknown.
    """
    phase = samples.phase_rad
    design = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)], axis=1)
    solve = np.linalg.pinv(design)
    part = samples.z @ solve.T
    noise = np.maximum(samples.z, 0.0).mean(axis=-1) + samples.floor_var
    value = part[..., 1] + 1j * part[..., 2]
    spread = 0.5 * float((solve[1:] ** 2).sum()) * noise
    turn = 2 * np.pi * samples.frequency_hz * samples.t0_s
    sound = samples.good.all(axis=-1) & (np.linalg.matrix_rank(design) == 3) & (np.abs(value) > 0)
    return Phasors(value, spread, np.angle(value * np.exp(1j * turn)), sound)
