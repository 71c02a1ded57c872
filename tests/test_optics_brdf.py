"""Laws of the surface models: reciprocity, energy, normalisation, finiteness; Eq. 4 of Guo et al. 2017 in its conventions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from beambench.optics.reflection.albedo import albedo_limit, conserves_energy, hemispherical_albedo
from beambench.optics.reflection.angles import Angles, Array, angles, monostatic
from beambench.optics.reflection.chua import FIGURE_2_SURFACES, chua, chua_printed
from beambench.optics.reflection.cook_torrance import cook_torrance, facet_density, schlick
from beambench.optics.reflection.lambert import lambert
from beambench.optics.reflection.phong import phong

Response = Callable[[Angles], Array]
CHUA = {"k_s": 0.5, "k_d": 0.2, "slope": 0.4, "diffusivity": 1.5}

RECIPROCAL: dict[str, Response] = {
    "lambert": partial(lambert, albedo=0.7),
    "phong": partial(phong, diffuse_albedo=0.3, specular_albedo=0.6, exponent=35.0),
    "beckmann": partial(cook_torrance, diffuse_albedo=0.2, f0=0.3, roughness=0.25, distribution="beckmann"),
    "ggx": partial(cook_torrance, diffuse_albedo=0.2, f0=0.3, roughness=0.25, distribution="ggx"),
    "chua": partial(chua, convention="reciprocal", **CHUA),
}
PRINTED: dict[str, Response] = {
    "printed radiance": partial(chua, convention="as-printed-radiance", **CHUA),
    "printed brdf": partial(chua, convention="brdf", **CHUA),
}
EVERY = RECIPROCAL | PRINTED


def _hemisphere(rng: np.random.Generator, count: int) -> Array:
    z = rng.uniform(0.0, 1.0, count)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=-1)


def _asymmetry(response: Response) -> float:
    """Largest |f(i,o) − f(o,i)|/(f + f) over random directions, in a rotated frame."""
    rng = np.random.default_rng(11)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    wi, wo = _hemisphere(rng, 4000) @ turn.T, _hemisphere(rng, 4000) @ turn.T
    n = turn @ np.array([0.0, 0.0, 1.0])
    there, back = angles(n, wi, wo), angles(n, wo, wi)
    f, g = response(there) / there.cos_i, response(back) / back.cos_i
    return float(np.max(np.abs(f - g) / (f + g + 1e-300)))


def test_angles_of_known_directions() -> None:
    s = np.sqrt(0.5)
    a = angles([0.0, 0.0, 1.0], [s, 0.0, s], [[-s, 0.0, s], [s, 0.0, s], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(a.cos_r, [1.0, 0.0, s], atol=1e-15)
    np.testing.assert_allclose(a.cos_h, [1.0, s, np.cos(np.pi / 8)], atol=1e-15)
    np.testing.assert_allclose(a.cos_d, [s, 1.0, np.cos(np.pi / 8)], atol=1e-15)


def test_monostatic_is_the_limit_of_angles() -> None:
    theta = np.linspace(0.0, 1.5, 40)
    w = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1)
    full, short = angles([0.0, 0.0, 1.0], w, w), monostatic(np.cos(theta))
    for name in ("cos_i", "cos_o", "cos_h", "cos_d", "cos_r"):
        np.testing.assert_allclose(getattr(full, name), getattr(short, name), atol=2e-15)


@pytest.mark.parametrize("name", RECIPROCAL)
def test_reciprocity(name: str) -> None:
    # 1e-10: rounding of the half vector (1e-16) times the logarithmic slope of the sharpest lobe met (about 1e4).
    assert _asymmetry(RECIPROCAL[name]) < 1e-10


@pytest.mark.parametrize("name", PRINTED)
def test_the_printed_law_is_not_reciprocal_off_axis(name: str) -> None:
    assert _asymmetry(PRINTED[name]) > 0.5


@pytest.mark.parametrize("name", EVERY)
def test_zero_below_the_surface_and_finite_to_grazing(name: str) -> None:
    rng = np.random.default_rng(3)
    theta = np.radians([0.0, 45.0, 89.0, 89.9, 89.99, 89.999])
    ti, to, phi = np.meshgrid(theta, theta, rng.uniform(0.0, 2.0 * np.pi, 64))
    wi = np.stack([np.sin(ti), np.zeros_like(ti), np.cos(ti)], axis=-1)
    wo = np.stack([np.sin(to) * np.cos(phi), np.sin(to) * np.sin(phi), np.cos(to)], axis=-1)
    with np.errstate(all="raise", under="ignore"):
        value = EVERY[name](angles([0.0, 0.0, 1.0], wi, wo))
        assert np.all(np.isfinite(value)) and np.all(value >= 0.0)
        assert np.all(np.isfinite(EVERY[name](monostatic(np.cos(theta)))))
        assert np.all(EVERY[name](angles([0.0, 0.0, 1.0], -wi, wo)) == 0.0)
        assert np.all(EVERY[name](angles([0.0, 0.0, 1.0], wi, -wo)) == 0.0)
        opposite = EVERY[name](angles([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]))
    assert opposite == 0.0


@pytest.mark.parametrize("slope", [0.01, 0.1, 0.3, 1.0, 3.0])
def test_narrow_slopes_never_overflow(slope: float) -> None:
    cos_theta = np.concatenate([np.cos(np.radians(np.linspace(0.0, 89.999, 500))), [1e-12, 1e-100]])
    for convention in ("as-printed-radiance", "brdf", "reciprocal"):
        value = chua(monostatic(cos_theta), k_s=1.0, k_d=0.0, slope=slope, diffusivity=1.0, convention=convention)
        assert np.all(np.isfinite(value))


def test_lambert_returns_its_albedo() -> None:
    theta = np.radians([0.0, 1.0, 20.0, 45.0, 60.0, 85.0, 89.9])
    value = hemispherical_albedo(RECIPROCAL["lambert"], theta)
    np.testing.assert_allclose(value, 0.7, rtol=1e-6)  # quadrature's error on a smooth response, measured 2e-8


@pytest.mark.parametrize("exponent", [0.0, 1.0, 7.5, 50.0, 1000.0])
def test_phong_is_normalised_at_normal_incidence(exponent: float) -> None:
    response = partial(phong, diffuse_albedo=0.25, specular_albedo=0.75, exponent=exponent)
    assert hemispherical_albedo(response, 0.0) == pytest.approx(1.0, abs=1e-6)
    assert conserves_energy(response)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("roughness", [0.006, 0.05, 0.3, 1.0])
def test_white_furnace_of_facets(distribution: str, roughness: float) -> None:
    response = partial(cook_torrance, diffuse_albedo=0.0, f0=1.0, roughness=roughness, distribution=distribution)
    theta = np.radians([0.0, 15.0, 45.0, 70.0, 85.0])
    value = hemispherical_albedo(response, theta)
    assert np.all(value <= 1.0 + 1e-4)
    if roughness <= 0.05:  # smooth facets shadow nothing and lose nothing away from grazing (GGX has long tails)
        assert np.all(value[:3] > 0.99)


#: The table in the docstring: height-correlated over exact masking in a coaxial rig, at 60, 70 and 80°.
COAXIAL = {
    ("beckmann", 0.2): (1.000, 0.999, 0.962), ("beckmann", 0.5): (0.987, 0.934, 0.779),
    ("beckmann", 1.0): (0.889, 0.785, 0.652), ("ggx", 0.2): (0.972, 0.938, 0.831),
    ("ggx", 0.5): (0.878, 0.794, 0.666), ("ggx", 1.0): (0.750, 0.671, 0.587),
}  # fmt: skip


def _seen_facets(theta: float, roughness: float, distribution: str) -> float:
    """∫ D(m) max(ω·m, 0) dm by a midpoint rule over slopes: all facets that face ω, before any is masked."""
    t = np.tan(0.5 * np.pi * (np.arange(4000) + 0.5) / 4000)
    tangent = roughness * t
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    # D cosθ dω in the slopes is a density of tanθ/α, over even azimuths: exp(−t²) or 1/(1 + t²)².
    weight = 2.0 * t * (np.exp(-(t**2)) if distribution == "beckmann" else 1.0 / (1.0 + t**2) ** 2)
    weight *= 0.5 * np.pi * (1.0 + t**2) / 4000
    azimuth = np.pi * (np.arange(720) + 0.5) / 720
    facing = np.maximum(np.cos(theta) + np.sin(theta) * tangent[:, None] * np.cos(azimuth), 0.0).mean(axis=1)
    assert np.sum(weight) == pytest.approx(1.0, abs=1e-3) and np.all(cosine > 0.0)
    return float(np.sum(weight * facing))


@pytest.mark.parametrize(("distribution", "roughness"), COAXIAL)
def test_masking_is_exact_for_a_coaxial_rig(distribution: Any, roughness: float) -> None:
    """All that the eye sees is lit: of the facets that face it, whose projection is ∫ D max(ω·m, 0) dm, it sees cosθ.

    That share is G, from an integral over slopes that holds no Λ; GGX's slow tail leaves 1e-3 beyond the last node.
    """
    law: dict[str, Any] = {"diffuse_albedo": 0.0, "f0": 1.0, "roughness": roughness, "distribution": distribution}
    for degrees, ratio in zip((60.0, 70.0, 80.0), COAXIAL[distribution, roughness], strict=True):
        theta = np.radians(degrees)
        at = monostatic(np.array([np.cos(theta)]))
        seen = np.cos(theta) / _seen_facets(theta, roughness, distribution)
        assert 1.0 / (2.0 - seen) == pytest.approx(ratio, abs=2e-3)  # (1 + Λ)/(1 + 2Λ) with Λ = 1/G − 1
        bare = 0.25 * facet_density(at.cos_h, roughness, distribution)[0] / np.cos(theta)
        if bare < 1e-300:  # no facet faces the rig: exp(−804)
            assert (distribution, roughness, degrees) == ("beckmann", 0.2, 80.0)
            continue
        exact = cook_torrance(at, masking="height-direction-correlated", **law)[0]
        assert exact / bare == pytest.approx(seen, rel=2e-3)
        usual = cook_torrance(at, masking="height-correlated", **law)[0]
        assert usual / exact == pytest.approx(ratio, abs=6e-4)


def test_masking_between_its_limits() -> None:
    """One azimuth: the steeper direction's Λ alone; opposite azimuths: nearly the height-correlated form; never above it."""
    law: dict[str, Any] = {"diffuse_albedo": 0.0, "f0": 1.0, "roughness": 0.5, "distribution": "ggx"}

    def value(first: float, second: float, azimuth: float, masking: Any) -> float:
        wi, wo = (
            np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
            for t, p in ((first, 0.0), (second, azimuth))
        )
        return float(cook_torrance(angles([0.0, 0.0, 1.0], wi, wo), masking=masking, **law))

    exact, usual = "height-direction-correlated", "height-correlated"

    def smith(theta: float) -> float:
        return 0.5 * (np.sqrt(1.0 + 0.25 * np.tan(theta) ** 2) - 1.0)

    ratio = value(1.0, 1.3, 0.0, exact) / value(1.0, 1.3, 0.0, usual)
    assert ratio == pytest.approx((1.0 + smith(1.0) + smith(1.3)) / (1.0 + smith(1.3)), rel=1e-6)
    share = 4.41 * np.pi / (4.41 * np.pi + 1.0)
    ratio = value(1.0, 1.3, np.pi, exact) / value(1.0, 1.3, np.pi, usual)
    assert ratio == pytest.approx((1.0 + smith(1.0) + smith(1.3)) / (1.0 + smith(1.3) + share * smith(1.0)), rel=1e-6)
    assert value(1.0, 1.3, 1.0, exact) == pytest.approx(
        value(1.3, 1.0, 1.0, exact) * np.cos(1.0) / np.cos(1.3), rel=1e-9
    )
    with pytest.raises(ValueError, match="height-correlated"):
        value(1.0, 1.0, 0.0, "none")


@pytest.mark.parametrize("masking", ["height-correlated", "height-direction-correlated"])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_neither_masking_makes_energy(distribution: Any, masking: Any) -> None:
    response = partial(cook_torrance, diffuse_albedo=0.0, f0=1.0, roughness=1.0, distribution=distribution,
                       masking=masking)  # fmt: skip
    assert conserves_energy(response)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0])
def test_facet_density_projects_to_one(distribution: str, roughness: float) -> None:
    # Independent of the module's quadrature: midpoint rule in arctan(tanθ/α).
    t = np.tan(0.5 * np.pi * (np.arange(200_000) + 0.5) / 200_000)  # tanθ/α, midpoint rule in its arctangent
    tangent = roughness * t
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    d_theta = roughness * 0.5 * np.pi / 200_000 * (1.0 + t * t) * cosine**2
    density = facet_density(cosine, roughness, distribution)
    total = np.sum(density * cosine * 2.0 * np.pi * tangent * cosine * d_theta)
    assert total == pytest.approx(1.0, abs=1e-6)


def test_schlick_ends() -> None:
    np.testing.assert_allclose(schlick(np.array([1.0, 0.0]), 0.04), [0.04, 1.0])


@pytest.mark.parametrize("name", EVERY)
def test_albedo_by_monte_carlo(name: str) -> None:
    """Another path: cosine-weighted random directions, within five standard errors, at 40° of incidence."""
    rng = np.random.default_rng(5)
    count = 400_000
    r, azimuth = np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    wo = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.sqrt(1.0 - r * r)], axis=-1)
    theta = np.radians(40.0)
    a = angles([0.0, 0.0, 1.0], [np.sin(theta), 0.0, np.cos(theta)], wo)
    sample = EVERY[name](a) * np.pi / np.cos(theta)
    exact = float(hemispherical_albedo(EVERY[name], theta))
    error = float(np.std(sample) / np.sqrt(count))
    assert abs(np.mean(sample) - exact) < 5.0 * error + 1e-6


def test_conventions_relate_in_the_coaxial_limit() -> None:
    cos_theta = np.cos(np.radians(np.linspace(0.0, 85.0, 60)))
    a = monostatic(cos_theta)
    printed = chua_printed(cos_theta, **CHUA)
    tangent2 = 1.0 / cos_theta**2 - 1.0
    plain = 0.5 / cos_theta**6 * np.exp(-tangent2 / 0.16) + 0.2 * cos_theta**1.5
    np.testing.assert_allclose(printed, plain, rtol=1e-9)
    np.testing.assert_allclose(chua(a, convention="as-printed-radiance", **CHUA), printed, rtol=1e-12)
    np.testing.assert_allclose(chua(a, convention="brdf", **CHUA), printed * cos_theta, rtol=1e-12)
    np.testing.assert_allclose(chua(a, convention="reciprocal", **CHUA), printed * cos_theta, rtol=1e-9)


def test_specular_term_is_beckmann_over_four_cosines() -> None:
    """K_S = 1/(4πs²) gives D/(4 cos²θ), a BRDF without foreshortening."""
    s = 0.35
    cos_theta = np.cos(np.radians(np.linspace(0.0, 80.0, 50)))
    printed = chua_printed(cos_theta, k_s=1.0 / (4.0 * np.pi * s * s), k_d=0.0, slope=s, diffusivity=1.0)
    np.testing.assert_allclose(printed, facet_density(cos_theta, s, "beckmann") / (4.0 * cos_theta**2), rtol=1e-10)


@pytest.mark.parametrize("convention", ["brdf", "reciprocal"])
def test_at_m_0_both_terms_are_brdfs(convention: Any) -> None:
    """Beckmann's facets without masking, D/(4cos²θ), over a Lambert base: what a coaxial rig sees is f·cosθ."""
    s, k_s, albedo = 0.35, 0.3, 0.4
    cosine = np.cos(np.radians(np.linspace(0.0, 80.0, 50)))
    found = chua(monostatic(cosine), k_s=k_s, k_d=albedo / np.pi, slope=s, diffusivity=0.0, convention=convention)
    density = np.exp(-(1.0 / cosine**2 - 1.0) / s**2) / (np.pi * s**2 * cosine**4)
    brdf = 4.0 * np.pi * s**2 * k_s * density / (4.0 * cosine**2) + albedo / np.pi
    np.testing.assert_allclose(found, brdf * cosine, rtol=1e-10)


def test_diffuse_term_at_m_1_is_lambert_with_foreshortening() -> None:
    cos_theta = np.cos(np.radians(np.linspace(0.0, 89.0, 50)))
    a = monostatic(cos_theta)
    printed = chua(a, k_s=0.0, k_d=0.4 / np.pi, slope=0.3, diffusivity=1.0, convention="as-printed-radiance")
    np.testing.assert_allclose(printed, lambert(a, albedo=0.4), rtol=1e-12)


def test_albedo_limit_tells_what_breaks_energy() -> None:
    radiance = partial(chua, k_s=0.0, k_d=0.5 / np.pi, slope=0.3, diffusivity=1.0, convention="as-printed-radiance")
    assert conserves_energy(radiance)
    assert hemispherical_albedo(radiance, 0.6) == pytest.approx(0.5, rel=1e-6)
    # π·value/cosθi: closed form of the printed law's albedo, since the value ignores the eye's direction.
    theta = np.radians([0.0, 30.0, 60.0])
    np.testing.assert_allclose(
        hemispherical_albedo(PRINTED["printed radiance"], theta),
        np.pi * chua_printed(np.cos(theta), **CHUA) / np.cos(theta),
        rtol=1e-6,
    )
    # m = 0 read as radiance grows as 1/cosθ: it must break the check near grazing, at the limit angle.
    flat = partial(chua, k_s=0.0, k_d=0.5 / np.pi, slope=0.3, diffusivity=0.0, convention="as-printed-radiance")
    value, where = albedo_limit(flat)
    assert not conserves_energy(flat)
    assert value == pytest.approx(0.5 / np.cos(where), rel=1e-5) and np.degrees(where) == pytest.approx(89.0, abs=0.01)
    # The reciprocal form at normal incidence: facets steeper than 45° send their light below the surface.
    s = 0.6
    lobe = partial(chua, k_s=0.25 / (np.pi * s * s), k_d=0.0, slope=s, diffusivity=1.0, convention="reciprocal")
    assert hemispherical_albedo(lobe, 0.0) == pytest.approx(1.0 - np.exp(-1.0 / s**2), abs=1e-5)
    assert not conserves_energy(lobe)  # no shadowing: it exceeds one near grazing


def test_figure_2_surfaces_fall_from_one_at_normal_incidence() -> None:
    cos_theta = np.cos(np.radians(np.linspace(0.0, 89.9, 400)))
    curves = {name: chua_printed(cos_theta, **k) for name, k in FIGURE_2_SURFACES.items()}
    for curve in curves.values():
        assert curve[0] == pytest.approx(1.0)
        assert np.all(np.diff(curve) <= 1e-12)
    at_30 = [float(np.interp(-np.cos(np.radians(30.0)), -cos_theta, c)) for c in curves.values()]
    assert at_30 == sorted(at_30)  # more glint falls faster


def test_unknown_names_are_refused() -> None:
    a = monostatic(np.array([0.5]))
    with pytest.raises(ValueError, match="convention"):
        chua(a, convention="radiance", **CHUA)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="distribution"):
        cook_torrance(a, diffuse_albedo=0.0, f0=1.0, roughness=0.3, distribution="phong")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="incidence"):
        hemispherical_albedo(RECIPROCAL["lambert"], 1.6)
