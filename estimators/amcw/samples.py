"""Reading an AMCW capture: samples in photoelectrons, and the phasor of every frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.amcw import modulation_wavelength
from ...optics.constants import C_M_PER_S
from ...scenes.errors import InputError
from ..declared import check_keys
from ..rig import DeclaredRig, read_rig
from .declared import AMCW_KEYS

__all__ = ["AmcwSamples", "Phasors", "phasors", "read_samples"]

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class AmcwSamples:
    """Samples of all shots, frequencies ascending.

    z (shot, frequency, phase): photoelectrons. good (likewise): finite, not clipped, not dead. usable (shot): marked valid, with
    the laser on. A sample of mean μ has the variance μ + floor_var. t0_s: lag of the reference. window_m: nearest and
    farthest range of a target.
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
    """Phasors (shot, frequency).

    value: D exp(iω(τ − t₀)); variance: that of its real part and of its imaginary part [e²]; phase: ωτ [rad], the declared
    t₀ taken out; sound: all samples are good, and their phases determine the phasor.
    """

    value: npt.NDArray[np.complex128]
    variance: Float
    phase: Float
    sound: Bool


def read_samples(capture: xr.Dataset) -> AmcwSamples:
    """Read an AMCW capture. Raises InputError where the rig or the samples cannot be used."""
    rig = read_rig(capture, "amcw")
    check_keys(rig, AMCW_KEYS)
    if "samples" not in capture or capture["samples"].dims != ("shot", "frequency", "phase"):
        raise InputError(
            "The capture has no samples of modulated light.", where="samples", value=tuple(capture.variables),
            allowed="dims (shot, frequency, phase)",
        )  # fmt: skip
    raw = capture["samples"].values
    frequency, phase = _settings(capture, rig)
    if raw.shape[1:] != (frequency.size, phase.size) or not (frequency > 0).all():
        raise InputError(
            "The samples do not fit the frequencies and phases.", where="samples", value=raw.shape,
            allowed=f"(shot, {frequency.size}, {phase.size}), frequencies above 0",
        )  # fmt: skip
    converter = rig.converter("detector")
    order = np.argsort(frequency)
    finite = np.isfinite(raw)
    good = finite & (raw < converter.saturation_dn) & (raw > converter.dead_dn)
    offset = converter.offset_dn
    z = (np.where(finite, raw, offset).astype(np.float64) - offset) / converter.gain_dn_per_e
    usable = np.ones(len(raw), dtype=bool)
    for name in ("valid", "laser_on"):
        if name in capture.variables:
            usable &= np.asarray(capture[name].values, dtype=bool)
    window = rig.numbers("range_window_m", length=2)
    return AmcwSamples(
        z[:, order], good[:, order], usable, frequency[order], phase, rig.number("medium.group_index", above=0),
        converter.floor_e2, rig.number("t0_s"), (float(window[0]), float(window[1])),
    )  # fmt: skip


def _settings(capture: xr.Dataset, rig: DeclaredRig) -> tuple[Float, Float]:
    """Modulation frequencies [Hz] and reference phases [rad]: coordinates of the capture, else as the rig declares them."""
    declared = rig.numbers("modulation.frequencies_hz", above=0)
    steps = rig.whole("modulation.phase_steps", least=3)
    frequency = np.asarray(capture["frequency"].values if "frequency" in capture.coords else declared, np.float64)
    even = 2 * np.pi * np.arange(steps) / steps
    return frequency, np.asarray(capture["phase"].values if "phase" in capture.coords else even, np.float64)


def phasors(samples: AmcwSamples) -> Phasors:
    """Least squares of M + a cos φ + b sin φ for every shot and frequency; D = a + ib.

    With n even phases D = (2/n) Σ z exp(iφ), with the variance 2σ²/n in either part. Frequencies with a clipped sample are
    not sound: without it the phases are no longer even, and the bias of the rest is unknown.
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
