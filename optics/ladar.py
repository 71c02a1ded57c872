"""The LADAR equation of Guo et al. 2017, Eq. 1-6 and 18-22, as printed and named by their numbers; and the pixel
radiometry that the generator uses.

All functions take scalars or arrays that broadcast, SI units, and return arrays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .constants import C_M_PER_S, PLANCK_J_S
from .correlation.forms import correlation
from .correlation.gates import Gate
from .correlation.parts import Array
from .correlation.pulses import Pulse
from .reflection.chua import chua_printed

__all__ = [
    "gated_intensity_eq18", "gated_intensity_eq19", "gated_intensity_eq20", "gated_intensity_eq21",
    "gaussian_pulse_power", "intensity_variation_eq22", "ladar_eq1_received_power", "ladar_eq2_beam_area",
    "ladar_eq3_received_power", "ladar_eq4_brdf", "ladar_eq5_pulse_power", "ladar_eq6_received_power", "photoelectrons",
    "pixel_energy", "pixel_photoelectrons", "pixel_radiance", "surface_fluence",
]  # fmt: skip


def _array(value: ArrayLike) -> Array:
    return np.asarray(value, dtype=np.float64)


def ladar_eq1_received_power(
    transmitted_power_w: ArrayLike, *, system_efficiency: ArrayLike, path_transmission: ArrayLike,
    aperture_diameter_m: ArrayLike, reflectivity: ArrayLike, target_area_m2: ArrayLike, range_m: ArrayLike,
    dispersion_sr: ArrayLike, divergence_rad: ArrayLike,
) -> Array:  # fmt: skip
    """Eq. 1: P_r = η_sys η_atm D² ρ A P_t / (r² θ_R (θ_t r)²), W. θ_t is the full divergence, θ_R a solid angle."""
    range_m, divergence_rad = _array(range_m), _array(divergence_rad)
    top = _array(system_efficiency) * _array(path_transmission) * _array(aperture_diameter_m) ** 2
    top = top * _array(reflectivity) * _array(target_area_m2) * _array(transmitted_power_w)
    return np.asarray(top / (range_m**2 * _array(dispersion_sr) * (divergence_rad * range_m) ** 2))


def ladar_eq2_beam_area(divergence_rad: ArrayLike, range_m: ArrayLike) -> Array:
    """Eq. 2: A = π θ_t² r²/4, m², footprint of the beam at range r."""
    return np.asarray(0.25 * np.pi * (_array(divergence_rad) * _array(range_m)) ** 2)


def ladar_eq3_received_power(
    transmitted_power_w: ArrayLike, *, system_efficiency: ArrayLike, path_transmission: ArrayLike,
    aperture_diameter_m: ArrayLike, reflection_per_sr: ArrayLike, range_m: ArrayLike,
) -> Array:  # fmt: skip
    """Eq. 3: P_r = π η_sys η_atm D²/(4r²) · (ρ/θ_R) · P_t, W: Eq. 1 for a target that fills the beam (Eq. 2).

    `reflection_per_sr` is ρ/θ_R; a Lambert surface seen along its normal has albedo/π.
    """
    gain = 0.25 * np.pi * _array(system_efficiency) * _array(path_transmission) * _array(aperture_diameter_m) ** 2
    return np.asarray(gain / _array(range_m) ** 2 * _array(reflection_per_sr) * _array(transmitted_power_w))


def ladar_eq4_brdf(
    incidence_rad: ArrayLike, *, k_s: ArrayLike, k_d: ArrayLike, slope: ArrayLike, diffusivity: ArrayLike
) -> Array:
    """Eq. 4 as printed, monostatic: K_s/cos⁶θ · exp(−tan²θ/s²) + K_D cos^m θ, for |θ| < π/2; 0 beyond.

    The reflection law, with its named conventions and its bidirectional extension, is in `reflection/chua.py`.
    """
    theta = _array(incidence_rad)
    cos = np.where(np.abs(theta) < 0.5 * np.pi, np.cos(theta), 0.0)
    return chua_printed(cos, k_s=_array(k_s), k_d=_array(k_d), slope=_array(slope), diffusivity=_array(diffusivity))


def ladar_eq5_pulse_power(t_s: ArrayLike, *, power_scale: ArrayLike, sigma_s: ArrayLike) -> Array:
    """Eq. 5 *as printed*: P_o/√(2πσ_p) · exp(−t²/2σ_p²), with σ_p under the root.

    Its integral is P_o·√σ_p, which depends on the unit of time; Eq. 6 prints the correct form, `gaussian_pulse_power`.
    """
    sigma = _array(sigma_s)
    return np.asarray(_array(power_scale) / np.sqrt(2.0 * np.pi * sigma) * np.exp(-0.5 * (_array(t_s) / sigma) ** 2))


def gaussian_pulse_power(t_s: ArrayLike, *, energy_j: ArrayLike, sigma_s: ArrayLike) -> Array:
    """The Gaussian pulse, correctly normalised: E/(√(2π)σ_p) · exp(−t²/2σ_p²), W, whose integral is E.

    Eq. 6 prints this form with "P_o" for E: P_o is therefore an energy.
    """
    sigma = _array(sigma_s)
    return np.asarray(_array(energy_j) / (np.sqrt(2.0 * np.pi) * sigma) * np.exp(-0.5 * (_array(t_s) / sigma) ** 2))


def ladar_eq6_received_power(
    t_s: ArrayLike, *, energy_j: ArrayLike, sigma_s: ArrayLike, system_efficiency: ArrayLike,
    path_transmission: ArrayLike, aperture_diameter_m: ArrayLike, range_m: ArrayLike, incidence_rad: ArrayLike,
    k_s: ArrayLike, k_d: ArrayLike, slope: ArrayLike, diffusivity: ArrayLike,
) -> Array:  # fmt: skip
    """Eq. 6: P_r(t) = π η_sys η_atm D²/(4r²) · BRDF(θ) · P_o/(√(2π)σ_p) · exp(−t²/2σ_p²), W; BRDF is Eq. 4.

    As printed, Eq. 4 gets no further factor cosθ.
    """
    return ladar_eq3_received_power(
        gaussian_pulse_power(t_s, energy_j=energy_j, sigma_s=sigma_s),
        system_efficiency=system_efficiency,
        path_transmission=path_transmission,
        aperture_diameter_m=aperture_diameter_m,
        reflection_per_sr=ladar_eq4_brdf(incidence_rad, k_s=k_s, k_d=k_d, slope=slope, diffusivity=diffusivity),
        range_m=range_m,
    )


def gated_intensity_eq18(
    received_energy_j: ArrayLike,
    pulse: Pulse,
    gate: Gate,
    *,
    range_m: ArrayLike,
    delay_s: ArrayLike,
    group_index: float,
) -> Array:
    """Eq. 18: I_i = ∫ P_r(t − 2r/c) G(t − t_i) dt, J: received energy × R(2 n_g r/c − t_i).

    Main arguments:
        received_energy_j: ∫ P_r dt.
        pulse, gate: shapes of `waveforms`; in the document a Gaussian and a rectangle.
        group_index: of the medium; 1 in the document.
    """
    u = 2.0 * group_index * _array(range_m) / C_M_PER_S - _array(delay_s)
    return np.asarray(_array(received_energy_j) * correlation(pulse, gate, u))


def gated_intensity_eq19(received_energy_j: ArrayLike, gate_area_s: ArrayLike, step_s: ArrayLike) -> Array:
    """Eq. 19: I = ∫P_r dt · ∫G dτ / t_step, J: the sum of Eq. 18 over all delays, spaced by t_step.

    It holds where the delays cover all of R and t_step is small against the edges of R (Poisson summation).
    """
    return np.asarray(_array(received_energy_j) * _array(gate_area_s) / _array(step_s))


def gated_intensity_eq20(
    *, energy_j: ArrayLike, sigma_s: ArrayLike, gate_s: ArrayLike, step_s: ArrayLike, **target: ArrayLike
) -> Array:
    """Eq. 20: Eq. 19 with the pulse of Eq. 6 integrated over all times (here by the trapezoid rule, ±10 σ_p, which is
    exact to rounding for a Gaussian) and a gate that is 1 over `gate_s`. `target` as in `intensity_variation_eq22`."""
    sigma = float(_array(sigma_s))
    t, dt = np.linspace(-10.0 * sigma, 10.0 * sigma, 401, retstep=True)
    energy = np.sum(gaussian_pulse_power(t, energy_j=_array(energy_j)[..., None], sigma_s=sigma), axis=-1) * dt
    return np.asarray(intensity_variation_eq22(**target) * energy * _array(gate_s) / _array(step_s))


def gated_intensity_eq21(*, energy_j: ArrayLike, gate_s: ArrayLike, step_s: ArrayLike, **target: ArrayLike) -> Array:
    """Eq. 21: I = π η_sys η_atm D²/(4r²) · BRDF(θ) · P_o · t_gate/t_step, J.

    `target`: the arguments of `intensity_variation_eq22`.
    """
    return np.asarray(intensity_variation_eq22(**target) * _array(energy_j) * _array(gate_s) / _array(step_s))


def intensity_variation_eq22(
    *, system_efficiency: ArrayLike, path_transmission: ArrayLike, aperture_diameter_m: ArrayLike, range_m: ArrayLike,
    incidence_rad: ArrayLike, k_s: ArrayLike, k_d: ArrayLike, slope: ArrayLike, diffusivity: ArrayLike,
) -> Array:  # fmt: skip
    """Eq. 22: ΔI = π η_sys η_atm D²/(4r²) · BRDF(θ), dimensionless: the factor that varies over the image."""
    return ladar_eq3_received_power(
        1.0,
        system_efficiency=system_efficiency,
        path_transmission=path_transmission,
        aperture_diameter_m=aperture_diameter_m,
        reflection_per_sr=ladar_eq4_brdf(incidence_rad, k_s=k_s, k_d=k_d, slope=slope, diffusivity=diffusivity),
        range_m=range_m,
    )


def surface_fluence(
    pulse_energy_j: ArrayLike, intensity_per_sr: ArrayLike, lamp_range_m: ArrayLike, attenuation_per_m: ArrayLike
) -> Array:
    """H = E·I(θ)·exp(−c r₁)/r₁², J/m² on a surface facing the laser; I is normalised to ∫I dΩ = 1."""
    r1 = _array(lamp_range_m)
    return np.asarray(
        _array(pulse_energy_j) * _array(intensity_per_sr) * np.exp(-_array(attenuation_per_m) * r1) / r1**2
    )


def pixel_radiance(
    fluence_j_per_m2: ArrayLike, response_per_sr: ArrayLike, camera_range_m: ArrayLike, attenuation_per_m: ArrayLike
) -> Array:
    """L = H·(f cosθᵢ)·exp(−c r₂), J/(m² sr) at the camera; the response f·cosθᵢ comes from `optics.reflection`."""
    loss = np.exp(-_array(attenuation_per_m) * _array(camera_range_m))
    return np.asarray(_array(fluence_j_per_m2) * _array(response_per_sr) * loss)


def pixel_energy(
    radiance_j_per_m2_sr: ArrayLike, pixel_area_m2: ArrayLike, f_number: ArrayLike, cos_field: ArrayLike = 1.0
) -> Array:
    """Q = L·A_px·π/(4F²)·cos⁴θ, J: the camera equation of a thin lens focused far away.

    `cos_field` is the cosine of the pixel's field angle, or 1 for a lens without vignetting. An aplanatic lens obeys
    this at all f-numbers (Abbe's sine condition); the effect of magnification, a factor (1 + f/r)², is neglected.
    """
    etendue = 0.25 * np.pi * _array(pixel_area_m2) / _array(f_number) ** 2
    return np.asarray(_array(radiance_j_per_m2_sr) * etendue * _array(cos_field) ** 4)


def photoelectrons(
    energy_j: ArrayLike, *, wavelength_m: ArrayLike, transmission: ArrayLike, quantum_efficiency: ArrayLike
) -> Array:
    """N = Q·τ·QE·λ/(hc): mean photoelectrons of the energy Q that the lens focuses onto a pixel."""
    per_joule = _array(wavelength_m) / (PLANCK_J_S * C_M_PER_S)
    return np.asarray(_array(energy_j) * _array(transmission) * _array(quantum_efficiency) * per_joule)


def pixel_photoelectrons(
    *, pulse_energy_j: ArrayLike, intensity_per_sr: ArrayLike, response_per_sr: ArrayLike, lamp_range_m: ArrayLike,
    camera_range_m: ArrayLike, attenuation_per_m: ArrayLike, pixel_area_m2: ArrayLike, f_number: ArrayLike,
    transmission: ArrayLike, quantum_efficiency: ArrayLike, wavelength_m: ArrayLike, cos_field: ArrayLike = 1.0,
) -> Array:  # fmt: skip
    """Mean photoelectrons of one pixel and one pulse through an open gate:

        N = E I(θ)/r₁² · (f cosθᵢ) · A_px π/(4F²) · cos⁴θ_field · τ QE λ/(hc) · exp(−c(r₁ + r₂)).

    Unscattered light only: exp(−c r) excludes light that the medium scatters forward. The surface must fill the pixel.
    """
    fluence = surface_fluence(pulse_energy_j, intensity_per_sr, lamp_range_m, attenuation_per_m)
    radiance = pixel_radiance(fluence, response_per_sr, camera_range_m, attenuation_per_m)
    energy = pixel_energy(radiance, pixel_area_m2, f_number, cos_field)
    return photoelectrons(
        energy, wavelength_m=wavelength_m, transmission=transmission, quantum_efficiency=quantum_efficiency
    )
