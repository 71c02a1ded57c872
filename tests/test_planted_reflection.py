"""Cook-Torrance against a third source: masking by Smith's integral over slopes, Schlick's fifth power, both written here.

`optics` and its copy for Mitsuba could share an error; this form shares no line with either. Smith's function is by
definition Λ(θ) = ∫_μ^∞ (q/μ − 1) P(q) dq with μ = cotθ and P the density of slopes along one direction: Gaussian of variance
α²/2 for Beckmann, α²/(2 (α² + q²)^{3/2}) for GGX (E. Heitz, JCGT 3(2):48, 2014, section 5). For Beckmann it has the closed
form Λ(a) = (e^{−a²}/(a√π) − erfc a)/2, a = μ/α.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from beambench.optics.reflection.angles import angles
from beambench.optics.reflection.cook_torrance import cook_torrance, facet_density, schlick
from beambench.scenes.materials import CookTorrance

KD, F0, ALPHA = 0.1, 0.2, 0.4
#: (θi, θo, azimuth between them), degrees: near the mirror direction, off it, coaxial, grazing, and with a wide difference
#: angle, where Schlick's power counts.
CASES = [
    (30.0, 30.0, 180.0), (60.0, 55.0, 180.0), (45.0, 45.0, 0.0), (75.0, 75.0, 0.0), (80.0, 70.0, 170.0),
    (82.0, 85.0, 180.0), (20.0, 65.0, 90.0), (85.0, 10.0, 40.0),
]  # fmt: skip


def direction(theta_deg: float, phi_deg: float) -> tuple[float, float, float]:
    t, p = math.radians(theta_deg), math.radians(phi_deg)
    return math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)


def smith(theta: float, alpha: float, distribution: str) -> float:
    """Λ(θ) by quadrature over slopes."""
    mu = 1.0 / math.tan(theta)

    def density(q: float) -> float:
        if distribution == "beckmann":
            return math.exp(-((q / alpha) ** 2)) / (alpha * math.sqrt(math.pi))
        return float(0.5 * alpha**2 / (alpha**2 + q * q) ** 1.5)

    # q = μ + t/(1 − t) maps the half line to 0 … 1.
    value = quad(lambda t: t / (1.0 - t) ** 3 / mu * density(mu + t / (1.0 - t)), 0.0, 1.0, epsabs=0.0, epsrel=1e-11)[0]
    return float(value)


def response(theta_i: float, theta_o: float, phi: float, distribution: str) -> float:
    """f cosθi by hand."""
    wi, wo = direction(theta_i, 0.0), direction(theta_o, phi)
    half = [a + b for a, b in zip(wi, wo, strict=True)]
    length = math.sqrt(sum(h * h for h in half))
    cos_h, cos_d = half[2] / length, sum(a * h for a, h in zip(wi, half, strict=True)) / length
    tan2 = 1.0 / cos_h**2 - 1.0
    if distribution == "beckmann":
        d = math.exp(-tan2 / ALPHA**2) / (math.pi * ALPHA**2 * cos_h**4)
    else:
        d = ALPHA**2 / (math.pi * cos_h**4 * (ALPHA**2 + tan2) ** 2)
    left = 1.0 - cos_d
    fresnel = F0 + (1.0 - F0) * (left * left * left * left * left)
    masked = 1.0 / (
        1.0 + smith(math.radians(theta_i), ALPHA, distribution) + smith(math.radians(theta_o), ALPHA, distribution)
    )
    return (KD / math.pi + fresnel * d * masked / (4.0 * wi[2] * wo[2])) * wi[2]


def test_the_closed_form_of_beckmann_is_smiths_integral() -> None:
    """The written third source against itself: two forms of one definition, a = .05 … 3."""
    for a in (0.05, 0.3, 1.0, 3.0):
        closed = 0.5 * (math.exp(-a * a) / (a * math.sqrt(math.pi)) - math.erfc(a))
        assert smith(math.atan(1.0 / (ALPHA * a)), ALPHA, "beckmann") == pytest.approx(closed, rel=1e-8)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_optics_is_the_third_source(distribution: str) -> None:
    """To 1e-8 at eight pairs of directions. A fourth power for the fifth or Λ × 1.2 moves some of them by over 5 %."""
    wi = np.array([direction(i, 0.0) for i, _, _ in CASES])
    wo = np.array([direction(o, phi) for _, o, phi in CASES])
    got = cook_torrance(
        angles([0.0, 0.0, 1.0], wi, wo), diffuse_albedo=KD, f0=F0, roughness=ALPHA,
        distribution=distribution,  # type: ignore[arg-type]
    )  # fmt: skip
    np.testing.assert_allclose(got, [response(*case, distribution) for case in CASES], rtol=1e-8)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_the_copy_for_mitsuba_is_the_third_source(distribution: str) -> None:
    """The same numbers from the plug-in, in single precision: 2e-5 of each, 5e-5 at grazing angles."""
    from beambench.generator.bsdf.plugin import mitsuba_bsdf
    from beambench.generator.rays.backend import mitsuba

    mi = mitsuba()
    import drjit as dr  # after Mitsuba, whose loading chooses libLLVM

    material = CookTorrance(diffuse_albedo=KD, f0=F0, roughness=ALPHA, distribution=distribution)  # type: ignore[arg-type]
    light = np.array([direction(i, 0.0) for i, _, _ in CASES], np.float32).T
    eye = np.array([direction(o, phi) for _, o, phi in CASES], np.float32).T
    at = dr.zeros(mi.SurfaceInteraction3f, len(CASES))
    at.wi = mi.Vector3f(eye)
    value = mitsuba_bsdf(material).eval(mi.BSDFContext(), at, mi.Vector3f(light))
    got = np.asarray(value.numpy(), np.float64).ravel()
    np.testing.assert_allclose(got, [response(*case, distribution) for case in CASES], rtol=5e-5)


def test_schlick_at_60_degrees() -> None:
    """f0 + (1 − f0)/32 where cosθ = ½: .04 → .07, .2 → .225; 1 at grazing, f0 at normal incidence."""
    np.testing.assert_allclose(schlick(np.array([0.5, 0.0, 1.0]), 0.04), [0.07, 1.0, 0.04], rtol=1e-12)
    np.testing.assert_allclose(schlick(np.array([0.5]), 0.2), [0.225], rtol=1e-12)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("alpha", [0.1, 0.4, 0.9])
def test_facets_cover_the_surface_once(distribution: str, alpha: float) -> None:
    """∫ D cosθ dω = 1, by scipy over cosθ: the slope of the integrand is finite for α of .1 and more."""
    value = quad(
        lambda c: 2.0 * math.pi * c * float(facet_density(np.array([c]), alpha, distribution)[0]),  # type: ignore[arg-type]
        0.0, 1.0, epsrel=1e-9, limit=400,
    )[0]  # fmt: skip
    assert value == pytest.approx(1.0, rel=1e-7)
