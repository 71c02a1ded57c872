"""The LADAR equation as printed, its inner consistency, and the pixel radiometry against independent derivations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from beambench.optics import ladar
from beambench.optics.constants import C_M_PER_S, PLANCK_J_S
from beambench.optics.correlation.waveforms import GaussianPulse, RectangularGate, gate_area

NS = 1e-9
SYSTEM = {"system_efficiency": 0.6, "path_transmission": 0.8, "aperture_diameter_m": 0.05}
SURFACE = {"incidence_rad": 0.4, "k_s": 0.7, "k_d": 0.3, "slope": 0.3, "diffusivity": 1.5}


def test_eq1_with_eq2_is_eq3() -> None:
    r, divergence = np.array([1.0, 5.0, 20.0]), 0.01
    area = ladar.ladar_eq2_beam_area(divergence, r)
    one = ladar.ladar_eq1_received_power(
        2.0,
        **SYSTEM,
        reflectivity=0.5,
        target_area_m2=area,
        range_m=r,
        dispersion_sr=np.pi,
        divergence_rad=divergence,
    )
    three = ladar.ladar_eq3_received_power(2.0, **SYSTEM, reflection_per_sr=0.5 / np.pi, range_m=r)
    np.testing.assert_allclose(one, three, rtol=1e-13)
    np.testing.assert_allclose(three[0] / three[1], 25.0, rtol=1e-13)


def test_eq3_is_the_lambert_aperture_share() -> None:
    # A Lambert surface of albedo ρ facing the receiver sends ρP/π per sr along its normal; the aperture holds
    # (πD²/4)/r² sr of it.
    got = ladar.ladar_eq3_received_power(
        3.0, system_efficiency=1.0, path_transmission=1.0, aperture_diameter_m=0.1, reflection_per_sr=0.4 / np.pi,
        range_m=7.0,
    )  # fmt: skip
    np.testing.assert_allclose(got, 3.0 * 0.4 / np.pi * (0.25 * np.pi * 0.1**2) / 7.0**2, rtol=1e-13)


def test_eq4_values() -> None:
    theta = np.array([0.0, 0.3, 1.0, 1.5, np.pi / 2, 2.0])
    got = ladar.ladar_eq4_brdf(theta, k_s=0.7, k_d=0.3, slope=0.3, diffusivity=1.5)
    cos, tan = np.cos(theta[:4]), np.tan(theta[:4])
    np.testing.assert_allclose(got[:4], 0.7 / cos**6 * np.exp(-((tan / 0.3) ** 2)) + 0.3 * cos**1.5, rtol=1e-12)
    assert got[0] == 1.0 and got[4] == got[5] == 0.0
    grazing = ladar.ladar_eq4_brdf(
        np.pi / 2 - 10.0 ** np.arange(-15.0, 0.0), k_s=1.0, k_d=1.0, slope=3.0, diffusivity=1
    )
    assert np.all(np.isfinite(grazing))


def test_eq5_misplaces_sigma() -> None:
    sigma = 0.4 * NS

    def integral(power: object, **scale: float) -> float:
        return quad(lambda x: power(x * sigma, sigma_s=sigma, **scale) * sigma, -12, 12, epsrel=1e-12)[0]  # type: ignore[operator]

    np.testing.assert_allclose(integral(ladar.gaussian_pulse_power, energy_j=2.0), 2.0, rtol=1e-10)
    np.testing.assert_allclose(integral(ladar.ladar_eq5_pulse_power, power_scale=2.0), 2.0 * np.sqrt(sigma), rtol=1e-10)


def test_eq6_is_eq3_with_eq4_and_the_right_pulse() -> None:
    t = np.linspace(-1.0, 1.0, 11) * NS
    got = ladar.ladar_eq6_received_power(t, energy_j=1e-3, sigma_s=0.4 * NS, **SYSTEM, range_m=5.0, **SURFACE)
    brdf = 0.7 / np.cos(0.4) ** 6 * np.exp(-((np.tan(0.4) / 0.3) ** 2)) + 0.3 * np.cos(0.4) ** 1.5
    pulse = 1e-3 / (np.sqrt(2.0 * np.pi) * 0.4 * NS) * np.exp(-0.5 * (t / (0.4 * NS)) ** 2)
    np.testing.assert_allclose(got, np.pi * 0.6 * 0.8 * 0.05**2 / 100.0 * brdf * pulse, rtol=1e-12)


def test_eq18_to_eq21_against_integration() -> None:
    sigma, gate_s, step, r = 0.4 * NS, 3.0 * NS, 0.1 * NS, 5.0
    pulse, gate = GaussianPulse(sigma * np.sqrt(8.0 * np.log(2.0))), RectangularGate(gate_s, 1.0)
    target = {**SYSTEM, "range_m": r, **SURFACE}
    energy = float(ladar.intensity_variation_eq22(**target)) * 1e-3
    t0 = 2.0 * r / C_M_PER_S
    delays = t0 - 8.0 * NS + step * np.arange(160)
    got = ladar.gated_intensity_eq18(energy, pulse, gate, range_m=r, delay_s=delays, group_index=1.0)

    def printed(delay: float) -> float:
        """Eq. 18 by quadrature: ∫ P_r(t − 2r/c) G(t − t_i) dt over the open gate, in ns around t0."""
        lo, hi = (np.clip((delay + edge - t0) / sigma, -12.0, 12.0) for edge in (0.0, gate_s))

        def power(x: float) -> float:
            return float(ladar.ladar_eq6_received_power(x * sigma, energy_j=1e-3, sigma_s=sigma, **target)) * sigma

        return quad(power, lo, hi, epsabs=1e-12 * energy, points=[0.0] if lo < 0.0 < hi else None)[0]

    some = np.arange(0, 160, 9)
    np.testing.assert_allclose(got[some], [printed(delays[i]) for i in some], atol=1e-10 * energy)
    # Eq. 19: the sum over delays, exact by Poisson summation where step ≪ σ (here 2πσ/step = 25).
    total = ladar.gated_intensity_eq19(energy, gate_area(gate), step)
    np.testing.assert_allclose(np.sum(got), total, rtol=1e-10)
    twenty = ladar.gated_intensity_eq20(energy_j=1e-3, sigma_s=sigma, gate_s=gate_s, step_s=step, **target)
    twenty_one = ladar.gated_intensity_eq21(energy_j=1e-3, gate_s=gate_s, step_s=step, **target)
    np.testing.assert_allclose(twenty, total, rtol=1e-12)
    np.testing.assert_allclose(twenty_one, total, rtol=1e-12)


CAMERA = {"transmission": 0.7, "quantum_efficiency": 0.4, "wavelength_m": 532e-9}


@pytest.mark.parametrize("field_rad", [0.0, 0.2, 0.5])
def test_pixel_against_the_aperture_derivation(field_rad: float) -> None:
    """Energy that the pixel's footprint intercepts, scattered by a Lambert plane, caught by the aperture's disc."""
    focal, f_number, pitch, depth, energy, intensity, albedo = 0.025, 2.0, 10e-6, 4.0, 1e-3, 3.0, 0.5
    cos, diameter = np.cos(field_rad), focal / f_number
    r = depth / cos
    footprint = (pitch * depth / focal) ** 2  # on the plane at this depth
    intercepted = energy * intensity * footprint * cos / r**2  # projected area over r²
    per_sr = intercepted * albedo / np.pi * cos  # Lambert's cosine towards the lens
    caught = per_sr * 0.25 * np.pi * diameter**2 * cos / r**2  # the aperture is seen under cos
    want = caught * 0.7 * 0.4 * 532e-9 / (PLANCK_J_S * C_M_PER_S)
    got = ladar.pixel_photoelectrons(
        pulse_energy_j=energy,
        intensity_per_sr=intensity,
        response_per_sr=albedo / np.pi * cos,
        lamp_range_m=r,
        camera_range_m=r,
        attenuation_per_m=0.0,
        pixel_area_m2=pitch**2,
        f_number=f_number,
        cos_field=cos,
        **CAMERA,
    )
    np.testing.assert_allclose(got, want, rtol=1e-12)


def test_all_pixels_together_catch_eq3() -> None:
    # A narrow beam falls wholly into the image: the sum over pixels is Eq. 3 (small angles: cos⁴ of 5 mrad is 1e-4).
    focal, f_number, pitch, depth, half = 0.1, 4.0, 5e-6, 10.0, 2e-3
    side = 256
    x = (np.arange(side) - 127.5) * pitch / focal
    theta = np.hypot(x[:, None], x)
    intensity = np.where(theta <= half, 1.0 / (4.0 * np.pi * np.sin(half / 2) ** 2), 0.0)
    fluence = ladar.surface_fluence(1e-3, intensity, depth, 0.0)
    energy = np.sum(ladar.pixel_energy(ladar.pixel_radiance(fluence, 0.5 / np.pi, depth, 0.0), pitch**2, f_number))
    three = ladar.ladar_eq3_received_power(
        1e-3,
        system_efficiency=1.0,
        path_transmission=1.0,
        aperture_diameter_m=focal / f_number,
        reflection_per_sr=0.5 / np.pi,
        range_m=depth,
    )
    # The disc's edge on a grid of 80 px diameter: relative error of the pixel count about 1/80^1.5 = 1.4e-3.
    np.testing.assert_allclose(energy, three, rtol=3e-3)


def test_energy_balance_of_a_lambert_patch() -> None:
    # All of the light that a patch sends into the hemisphere is albedo × what it received.
    theta: NDArray[np.float64] = (np.arange(4000) + 0.5) * (0.5 * np.pi) / 4000
    radiance = ladar.pixel_radiance(2.0, 0.37 / np.pi, 1.0, 0.0)
    sent = np.sum(radiance * np.cos(theta) * 2.0 * np.pi * np.sin(theta)) * (0.5 * np.pi) / 4000
    np.testing.assert_allclose(sent, 0.37 * 2.0, rtol=1e-6)  # midpoint rule: h²/6


def test_photoelectrons_range_and_attenuation() -> None:
    # One joule of green light holds 2.678e18 photons.
    one = ladar.photoelectrons(1.0, wavelength_m=532e-9, transmission=1.0, quantum_efficiency=1.0)
    np.testing.assert_allclose(one, 2.678e18, rtol=2e-4)
    base = {
        "pulse_energy_j": 1e-3, "intensity_per_sr": 3.0, "response_per_sr": 0.1, "pixel_area_m2": 1e-10,
        "f_number": 2.0,
    }  # fmt: skip
    r = np.array([1.0, 2.0, 4.0])
    clear = ladar.pixel_photoelectrons(**base, lamp_range_m=r, camera_range_m=r, attenuation_per_m=0.0, **CAMERA)
    murky = ladar.pixel_photoelectrons(**base, lamp_range_m=r, camera_range_m=r + 0.5, attenuation_per_m=0.3, **CAMERA)
    np.testing.assert_allclose(clear[0] / clear, r**2, rtol=1e-13)
    np.testing.assert_allclose(murky / clear, np.exp(-0.3 * (2.0 * r + 0.5)), rtol=1e-13)
