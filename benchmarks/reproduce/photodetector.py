"""The photodetector experiment of Figures 3, 4 and 7: one laser pulse, one surface, one record of an oscilloscope.

The set-up of Figure 1: a Q-switched laser of up to 1 mJ at 532 nm and a biased silicon photodiode of 400 µm with less than
300 ps of rise time. Of the values that are not printed only those are used that are possible with the printed ones
(`possible`): no load at which the diode's capacitance would make the edge longer than the printed one, and no noise below the
thermal noise of that load. Values that the document omits are our choice, in `Setup`; no lens is mentioned, and none is needed: a
surface of 80 % at 5 m gives 10 to 50 mV into 50 Ω. The experiment is self-contained: it uses the pulses and the LADAR
equation of `optics`, but neither the generator nor an estimator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S, PLANCK_J_S
from ...optics.correlation.detector_response import detected_pulse
from ...optics.correlation.pulses import GaussianPulse, broadened, pulse_density
from ...optics.ladar import ladar_eq3_received_power
from ...optics.reflection.chua import chua_printed

__all__ = [
    "ELECTRON_C", "MEASUREMENTS", "RANGE_M", "Setup", "Surface", "closed_form_std", "largest_load_ohm", "mean_signal", "measure",
    "possible", "speckle_cells", "surface", "thermal_noise_v", "times", "whole_record_std",
]  # fmt: skip

Array = NDArray[np.float64]

#: From the text: all surfaces at 5 m, averages of 30 measurements.
RANGE_M = 5.0
MEASUREMENTS = 30
#: Elementary charge, C, exact by definition of the SI.
ELECTRON_C = 1.602_176_634e-19
#: Boltzmann constant, J/K, exact by definition of the SI; a room's temperature, K.
_BOLTZMANN_J_PER_K, _ROOM_K = 1.380_649e-23, 295.0
#: Least capacitance of a biased silicon diode of 400 µm with its leads, F.
_DIODE_F = 1.0e-12


@dataclass(frozen=True)
class Setup:
    """The instrument. From the document: wavelength, energy (upper limit), diameter, rise time; the rest is our choice."""

    energy_j: float = 1.0e-3
    wavelength_m: float = 532.0e-9
    diameter_m: float = 400.0e-6
    rise_s: float = 300.0e-12
    pulse_fwhm_s: float = 1.0e-9
    quantum_efficiency: float = 0.5
    load_ohm: float = 50.0
    noise_v: float = 0.1e-3
    sample_s: float = 50.0e-12
    window_s: float = 20.0e-9
    beam_half_angle_rad: float = 1.0e-3

    @property
    def noise_e(self) -> float:
        """Electronic noise of one sample in photoelectrons: V·Δt/(R·q)."""
        return self.noise_v * self.sample_s / (self.load_ohm * ELECTRON_C)


def thermal_noise_v(setup: Setup) -> float:
    """Thermal (Johnson) noise of the load, V rms: √(4kTRB), B = .35/rise time; .031 mV for 50 Ω and 300 ps."""
    return math.sqrt(4.0 * _BOLTZMANN_J_PER_K * _ROOM_K * setup.load_ohm * 0.35 / setup.rise_s)


def largest_load_ohm(setup: Setup) -> float:
    """Largest load with the printed rise time, Ω: 2.2 RC ≤ rise, C = 1 pF; 136 Ω for 300 ps."""
    return setup.rise_s / (2.2 * _DIODE_F)


def possible(setup: Setup) -> bool:
    """Whether load and noise are possible with the rise time."""
    return setup.load_ohm <= largest_load_ohm(setup) and setup.noise_v >= thermal_noise_v(setup)


def speckle_cells(setup: Setup) -> float:
    """Number M of speckles on the detector: its mean light has the relative standard deviation 1/√M (Goodman 2007, §4.6).

    1/M = ⟨|μ|²⟩ over pairs of points of the disc, |μ(s)|² = exp(−s²/L²), L = λr/(πw) for a Gaussian spot of 1/e² radius
    w = half angle × r, polarised light, coherence longer than the depth of the spot. The laser is coherent and there is no
    lens, so that a narrow beam makes few, large speckles.
    """
    scale = setup.wavelength_m / (math.pi * setup.beam_half_angle_rad)
    share, step = np.linspace(0.0, 1.0, 4001, retstep=True)
    apart = 16.0 / math.pi * share * (np.arccos(share) - share * np.sqrt(1.0 - share**2))
    return 1.0 / float(np.sum(apart * np.exp(-((share * setup.diameter_m / scale) ** 2))) * step)


@dataclass(frozen=True)
class Surface:
    """Eq. 4 with `k_s`, `k_d` in 1/sr."""

    name: str
    k_s: float
    k_d: float
    slope: float

    def response(self, incidence_rad: float) -> float:
        """Eq. 4, used as in Eq. 6: no further cosθ, m = 1."""
        cos = np.array([math.cos(incidence_rad)])
        return float(chua_printed(cos, k_s=self.k_s, k_d=self.k_d, slope=self.slope, diffusivity=1.0)[0])


def surface(name: str, reflectivity: float, slope: float, glossy_share: float = 0.3) -> Surface:
    """A surface of total reflectivity `reflectivity`, `glossy_share` of it in a Beckmann lobe of rms slope s/√2.

    K_S = share·ρ/(4πs²): by conservation of energy the lobe contains the same light whatever its width. K_D = (1 −
    share)·ρ/π.
    """
    return Surface(
        name,
        glossy_share * reflectivity / (4.0 * math.pi * slope**2),
        (1.0 - glossy_share) * reflectivity / math.pi,
        slope,
    )


def times(setup: Setup) -> Array:
    """Sample times of the record relative to the echo of RANGE_M, s: centred on it."""
    half = round(0.5 * setup.window_s / setup.sample_s)
    return np.asarray(setup.sample_s * np.arange(-half, half + 1), dtype=np.float64)


def mean_signal(setup: Setup, target: Surface, incidence_rad: float, shift_s: float = 0.0) -> Array:
    """Expected photoelectrons per sample of the record, the echo `shift_s` later than that of RANGE_M.

    Eq. 3 with D the diameter of the detector; the pulse as recorded by the detector, and broadened by the tilted
    footprint, whose path lengths spread by σ = 2·(w r/2)·tanθ/c for a beam of 1/e² half angle w.
    """
    joule = float(
        ladar_eq3_received_power(
            setup.energy_j, system_efficiency=1.0, path_transmission=1.0, aperture_diameter_m=setup.diameter_m,
            reflection_per_sr=target.response(incidence_rad), range_m=RANGE_M,
        )
    )  # fmt: skip
    electrons = joule * setup.quantum_efficiency * setup.wavelength_m / (PLANCK_J_S * C_M_PER_S)
    shown, _delay = detected_pulse(GaussianPulse(setup.pulse_fwhm_s), "gaussian", setup.rise_s)
    stretch = setup.beam_half_angle_rad * RANGE_M * math.tan(incidence_rad) / C_M_PER_S
    if stretch > 0.0:
        shown = broadened(shown, stretch)
    return np.asarray(electrons * setup.sample_s * pulse_density(shown, times(setup) - shift_s), dtype=np.float64)


def _window(setup: Setup) -> int:
    """Half width in samples of the window around the brightest sample: twice the FWHM of the detected pulse."""
    return round(2.0 * math.hypot(setup.pulse_fwhm_s, 0.92 * setup.rise_s) / setup.sample_s)


def closed_form_std(setup: Setup, signal: Array) -> float:
    """Standard deviation of the windowed weighted average, m, to first order in the noise."""
    k = _window(setup)
    i = int(np.argmax(signal))
    part, t = signal[i - k : i + k + 1], times(setup)[i - k : i + k + 1]
    mean = float(np.sum(part * t) / np.sum(part))
    variance = float(np.sum((part + setup.noise_e**2) * (t - mean) ** 2)) / float(np.sum(part)) ** 2
    return 0.5 * C_M_PER_S * math.sqrt(variance)


def whole_record_std(setup: Setup, signal: Array) -> float:
    """Standard deviation of Σ V t/Σ V over the whole record without a baseline, m, to first order in the noise."""
    t = times(setup)
    mean = float(np.sum(signal * t) / np.sum(signal))
    variance = float(np.sum((signal + setup.noise_e**2) * (t - mean) ** 2)) / float(np.sum(signal)) ** 2
    return 0.5 * C_M_PER_S * math.sqrt(variance)


def measure(
    setup: Setup,
    signal: Array,
    rng: np.random.Generator,
    *,
    count: int = MEASUREMENTS,
    windowed: bool = True,
    baseline_e: float = 0.0,
) -> Array:
    """Range errors of `count` measurements by weighted average Σ V t/Σ V, m, relative to RANGE_M.

    Photon noise (in its normal limit: the pulse has thousands of electrons) and electronic noise per sample. `windowed`:
    the average is over ± 2 FWHM around the brightest sample; otherwise over the whole record. `baseline_e` per sample is
    added to the record and not subtracted.
    """
    t = times(setup)
    noise = rng.standard_normal((count, t.size)) * np.sqrt(signal + setup.noise_e**2)
    record = signal + baseline_e + noise
    if not windowed:
        return np.asarray(0.5 * C_M_PER_S * (record @ t) / record.sum(axis=1))
    k = _window(setup)
    at = np.clip(np.argmax(record, axis=1), k, t.size - 1 - k)
    index = at[:, None] + np.arange(-k, k + 1)
    part = np.take_along_axis(record, index, axis=1)
    return np.asarray(0.5 * C_M_PER_S * np.sum(part * t[index], axis=1) / np.sum(part, axis=1))
