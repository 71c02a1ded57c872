"""Cramer-Rao bound of the range of every shot of an AMCW capture, mean and modulation profiled.

Sample (f, k) has the mean μ = M + D cos(ω_f τ − φ_k) + v, D = A m d/2, M = A + ambient + dark, v the light
scattered back by the water (known, as it does not depend on the target; it adds noise only). With J the exact information
of a sample (Poisson ⊗ Gaussian ⊗ ADC) and gradients (−D ω sin · 2n_g/c, 1, cos): σ² = (F⁻¹)₀₀. The bound is local: the
number of whole cycles, which an estimator must determine, is taken as known.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...estimators.rig import DeclaredRig
from ...optics.amcw import modulation_wavelength
from ...optics.constants import C_M_PER_S
from ...optics.likelihood.fisher_table import information_table
from ...optics.likelihood.model import NoiseModel
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import AmcwRig, amcw_rig
from ...scenes.scene import Scene
from ..scores.truth import Bound
from .footprint import footprint_std_s, is_wide
from .instrument import bounded, true_scene, unbounded
from .profiled import profiled_sigma

__all__ = ["amcw_bound", "amcw_noise", "background_of"]

Float = npt.NDArray[np.float64]


def amcw_bound(capture: xr.Dataset) -> Bound:
    """The bound of every shot of a generated AMCW capture.

    `scale` is the standard deviation of a uniform error over half the shortest modulation wavelength, λ_m/(2√12), so that an
    error of one cycle counts as a failure. `kind` is "exact", or "quasi" if the power fluctuates from shot to shot, or if the
    footprint of any shot spreads the phase of the highest frequency by more than a tenth of a radian (it loses contrast); "none"
    without true scene and amplitude, with scales from the declared rig. Raises InputError for an invalid true scene, or for a
    declared rig that lacks a required value.
    """
    if not bounded(capture, "truth_amplitude"):
        return unbounded(capture, _declared_scales)
    scene = true_scene(capture)
    rig = amcw_rig(scene)
    detector = rig.detector
    index = group_index(scene.medium, rig.laser.wavelength_m)
    half = C_M_PER_S / (2.0 * index)
    frequency = np.asarray(rig.modulation.frequencies_hz, np.float64)
    scale = _shortest_scale(frequency, index)
    window = rig.range_window_m[1] - rig.range_window_m[0]
    truth = np.asarray(capture["truth_range"].values, np.float64)
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)[:, None]
    background = background_of(capture, rig)
    depth = 0.5 * rig.laser.modulation_depth * detector.demodulation_contrast * amplitude
    omega = 2.0 * np.pi * np.repeat(frequency, rig.modulation.phase_steps)
    phase = np.tile(2.0 * np.pi * np.arange(rig.modulation.phase_steps) / rig.modulation.phase_steps, frequency.size)
    turn = omega * (np.nan_to_num(truth)[:, None] / half - rig.t0_s) - phase
    mean = np.maximum(amplitude + background + depth * np.cos(turn), 0.0)
    gradient = np.stack([-depth * omega * np.sin(turn) / half, np.ones_like(turn), np.cos(turn)])
    information = np.asarray(information_table(amcw_noise(rig))(mean), np.float64)
    sigma = profiled_sigma(information, gradient)
    kind = "quasi" if rig.laser.power_fluctuation > 0 or _is_wide(scene, rig, float(omega.max())) else "exact"
    return Bound(np.where(np.isfinite(truth), sigma, np.nan), kind, scale, window)


def _is_wide(scene: Scene, rig: AmcwRig, omega: float) -> bool:
    field = math.atan2(0.5 * rig.detector.active_diameter_m, rig.receiver.focal_length_m)
    reach = rig.scan_half_angle_rad
    angle = np.linspace(-reach, reach, rig.shots) if rig.shots > 1 else np.zeros(1)
    return is_wide(footprint_std_s(scene, rig.laser.illumination, rig.laser.wavelength_m, field, angle), 1.0 / omega)


def _shortest_scale(frequency: Float, index: float) -> float:
    return float(modulation_wavelength(frequency.max(), index)) / (2.0 * math.sqrt(12.0))


def _declared_scales(rig: DeclaredRig) -> tuple[float, float]:
    """(scale, window) of the declared modulation and range window."""
    frequency = rig.numbers("modulation.frequencies_hz", above=0)
    near, far = (float(value) for value in rig.numbers("range_window_m", length=2))
    return _shortest_scale(frequency, rig.number("medium.group_index", above=0)), far - near


def amcw_noise(rig: AmcwRig) -> NoiseModel:
    """The likelihood of one sample, photoelectrons to DN."""
    detector = rig.detector
    return NoiseModel(
        read_noise_e=detector.read_noise_e,
        gain_dn_per_e=detector.gain_dn_per_e,
        offset_dn=detector.offset_dn,
        adc_max_dn=2**detector.adc_bits - 1,
        full_well_e=detector.full_well_e,
    )


def background_of(capture: xr.Dataset, rig: AmcwRig) -> Float:
    """Ambient, dark and scattered electrons of the samples, (shots or 1, samples or 1)."""
    if "truth_background" in capture:
        return np.asarray(capture["truth_background"].values, np.float64).reshape(capture["truth_range"].size, -1)
    # Older captures hold no light scattered by the water.
    level = (0.5 * rig.ambient_e_per_s + rig.detector.dark_e_per_s) * rig.modulation.integration_s
    return np.full((1, 1), level)
