"""Our Mitsuba BSDFs against the laws of optics, against their own densities, and against energy and reciprocity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.bsdf.plugin import mitsuba_bsdf
from beambench.generator.rays.backend import mitsuba
from beambench.optics.reflection.albedo import hemispherical_albedo
from beambench.optics.reflection.angles import angles
from beambench.scenes.materials import Chua, CookTorrance, Lambert, Material, Phong

Float = NDArray[np.float64]

MATERIALS: dict[str, Material] = {
    "lambert": Lambert(albedo=0.6),
    "phong": Phong(diffuse_albedo=0.3, specular_albedo=0.5, exponent=40.0),
    "phong, flat lobe": Phong(diffuse_albedo=0.0, specular_albedo=0.9, exponent=0.0),
    "ggx": CookTorrance(diffuse_albedo=0.3, f0=0.1, roughness=0.3, distribution="ggx"),
    "beckmann": CookTorrance(diffuse_albedo=0.3, f0=0.6, roughness=0.15, distribution="beckmann"),
    "ggx, coaxial": CookTorrance(diffuse_albedo=0.3, f0=0.1, roughness=0.6, distribution="ggx",
                                 masking="height-direction-correlated"),
    "beckmann, coaxial": CookTorrance(diffuse_albedo=0.1, f0=0.6, roughness=0.9, distribution="beckmann",
                                      masking="height-direction-correlated"),
    "chua": Chua(k_s=0.2, k_d=0.16, slope=0.35, diffusivity=1.4, convention="reciprocal"),
    "chua as brdf": Chua(k_s=0.2, k_d=0.16, slope=0.35, diffusivity=1.4, convention="brdf"),
    "chua as printed": Chua(k_s=0.2, k_d=0.16, slope=0.35, diffusivity=1.0, convention="as-printed-radiance"),
}  # fmt: skip
RECIPROCAL = ("lambert", "phong", "phong, flat lobe", "ggx", "beckmann", "ggx, coaxial", "beckmann, coaxial", "chua")


def directions(count: int, lowest: float, seed: int) -> Float:
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(lowest, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z])


def interaction(wi: Float) -> Any:
    mi = mitsuba()
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f, wi.shape[1])
    si.wi = mi.Vector3f(wi.astype(np.float32))
    return si


def evaluated(material: Material, wi: Float, wo: Float) -> Float:
    mi = mitsuba()
    value = mitsuba_bsdf(material).eval(mi.BSDFContext(), interaction(wi), mi.Vector3f(wo.astype(np.float32)))
    return np.asarray(value.numpy(), dtype=np.float64).ravel()


@pytest.mark.parametrize("name", MATERIALS)
def test_the_rungs_share_one_law(name: str) -> None:
    """eval(wi, wo) is the response of optics with light from wo: within 1e-5, float32 and its cosines included."""
    wi, wo = directions(20_000, 0.02, 1), directions(20_000, 0.02, 2)
    wi[:, :2000] = wo[:, :2000]  # the coaxial rig
    wo[:2, 2000:4000] = -wi[:2, 2000:4000]  # the mirror direction
    wo[2, 2000:4000] = wi[2, 2000:4000]
    expected = MATERIALS[name].response(angles([0.0, 0.0, 1.0], wo.T, wi.T))
    assert np.abs(evaluated(MATERIALS[name], wi, wo) - expected).max() < 1e-5 * expected.max()


@pytest.mark.parametrize("name", MATERIALS)
def test_both_sides_reflect_and_nothing_passes_through(name: str) -> None:
    wi, wo = directions(500, 0.02, 3), directions(500, 0.02, 4)
    front = evaluated(MATERIALS[name], wi, wo)
    flip = np.array([[1.0], [1.0], [-1.0]])
    assert np.allclose(evaluated(MATERIALS[name], wi * flip, wo * flip), front, rtol=1e-5)
    assert not evaluated(MATERIALS[name], wi, wo * flip).any()


@pytest.mark.parametrize("name", RECIPROCAL)
def test_reciprocity(name: str) -> None:
    wi, wo = directions(5000, 0.05, 5), directions(5000, 0.05, 6)
    there = evaluated(MATERIALS[name], wi, wo) / wo[2]
    back = evaluated(MATERIALS[name], wo, wi) / wi[2]
    assert np.abs(there - back).max() < 1e-5 * there.max()


@pytest.mark.parametrize("theta_deg", [5.0, 50.0, 75.0])
@pytest.mark.parametrize("name", RECIPROCAL)
def test_furnace(name: str, theta_deg: float) -> None:
    """In a uniform sky the mean weight of sampled directions is the hemispherical albedo by quadrature (4.5 σ over 24
    cases: a chance of 2e-4), and no more than one."""
    mi = mitsuba()
    count = 1 << 18
    theta = np.deg2rad(theta_deg)
    wi = np.repeat(np.array([[np.sin(theta)], [0.0], [np.cos(theta)]]), count, axis=1)
    random = mi.load_dict({"type": "independent"})
    random.seed(7, count)
    _, weight = mitsuba_bsdf(MATERIALS[name]).sample(
        mi.BSDFContext(), interaction(wi), random.next_1d(), random.next_2d()
    )
    value = np.asarray(weight.numpy(), dtype=np.float64).ravel()
    expected = float(hemispherical_albedo(MATERIALS[name].response, theta))
    assert np.isfinite(value).all() and (value >= 0).all()
    assert value.mean() == pytest.approx(expected, abs=4.5 * value.std() / np.sqrt(count) + 1e-5)
    assert expected <= 1.0


@pytest.mark.parametrize("theta_deg", [10.0, 60.0])
@pytest.mark.parametrize("name", MATERIALS)
def test_samples_follow_their_density(name: str, theta_deg: float) -> None:
    """Mitsuba's χ² test of sample() against pdf(), at a significance corrected for the number of cases."""
    mi = mitsuba()
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    bsdf, theta = mitsuba_bsdf(MATERIALS[name]), np.deg2rad(theta_deg)
    wi = [float(np.sin(theta)), 0.0, float(np.cos(theta))]

    def local(count: int) -> Any:
        import drjit as dr

        si = dr.zeros(mi.SurfaceInteraction3f, count)
        si.wi = mi.Vector3f(*wi)
        return si

    def sample(x: Any) -> Any:
        count = len(x[0])
        drawn, _ = bsdf.sample(mi.BSDFContext(), local(count), x[0], mi.Point2f(x[1], x[2]))
        import drjit as dr

        return drawn.wo, dr.select(drawn.pdf > 0, mi.Float(1.0), 0.0)

    def density(wo: Any) -> Any:
        return bsdf.pdf(mi.BSDFContext(), local(len(wo[0])), wo)

    test = ChiSquareTest(
        domain=SphericalDomain(), sample_func=sample, pdf_func=density, sample_dim=3, sample_count=200_000, res=101,
        ires=16,
    )  # fmt: skip
    assert test.run(0.01, test_count=len(MATERIALS) * 2, quiet=True), test.messages
