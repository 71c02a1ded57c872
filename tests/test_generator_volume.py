"""Scattered light of the full rung against quadratures, an independent walk, and the exact spread of multiple scatter."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.generator.gated.full import Limits, render_remainder
from beambench.generator.paths.phase import PhaseCells, free_path
from beambench.generator.rays.backend import mitsuba
from beambench.generator.rays.trace import pixel_directions
from beambench.optics.water.phase_forms import FournierForand, HenyeyGreenstein, PhaseFunction, phase_density
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

from ._gate_closed_form import electrons_per_radiance, gate_response, slices_of

C = 299_792_458.0
Float = NDArray[np.float64]


def water(phase: dict[str, object], absorption: float, scattering: float, **more: object) -> Scene:
    """A black wall 20 m away in water that scatters; gates from 2 m to 8 m."""
    return load_scene(
        "flat-wall",
        {
            "target.0.shape.center_m": [0.0, 0.0, 20.0],
            "target.0.material.albedo": 0.0,
            "medium": {
                "name": "water",
                "index": {"kind": "explicit", "phase": 1.34, "group": 1.36},
                "absorption_per_m": absorption,
                "scattering_per_m": scattering,
                "phase_function": phase,
            },
            "rig.camera.rows": 4,
            "rig.camera.cols": 4,
            "rig.camera.focal_length_m": 2.5e-4,
            "rig.delays.start_s": 2 * 2.0 * 1.36 / C,
            "rig.delays.step_s": 2 * 0.75 * 1.36 / C,
            "rig.delays.count": 9,
        }
        | more,
    )


def single_by_quadrature(scene: Scene, phase: PhaseFunction) -> Float:
    """(slices, rows, cols): ∫ b β̃(ψ) I e^{−c(r₁ + r₂)}/r₁² R dr₂ along each pixel's ray; 3×3 rays a pixel."""
    rig, medium = gated_rig(scene), scene.medium
    b, c = medium.scattering_per_m, medium.absorption_per_m + medium.scattering_per_m
    rows = rig.camera.rows
    sub = (np.arange(3 * rows) + 0.5) / 3 - 0.5
    row, col = np.meshgrid(sub, sub, indexing="ij")
    r2 = np.linspace(0.3, 11.0, 4000)
    lamp = np.asarray(rig.laser.position_m)
    out = np.zeros((len(slices_of(scene).delay_s), row.size))
    for i, d in enumerate(pixel_directions(rig.camera, row.ravel(), col.ravel()).T):
        way = r2[:, None] * d - lamp
        r1 = np.linalg.norm(way, axis=1)
        psi = np.pi - np.arccos(np.clip(way @ d / r1, -1, 1))
        inside = np.arccos(way[:, 2] / r1) <= rig.laser.illumination.half_angle_rad
        value = inside * b * phase_density(phase, psi) * np.exp(-c * (r1 + r2)) / r1**2
        tau = (r1 + r2) * 1.36 / C
        out[:, i] = np.trapezoid(gate_response(scene, tau) * value, r2, axis=1)
    n = rows
    return electrons_per_radiance(scene) * out.reshape(-1, n, 3, n, 3).mean(axis=(2, 4))


PHASES: dict[str, tuple[dict[str, object], PhaseFunction]] = {
    "isotropic": ({"kind": "henyey-greenstein", "g": 0.0}, HenyeyGreenstein(0.0)),
    "g = .9": ({"kind": "henyey-greenstein", "g": 0.9}, HenyeyGreenstein(0.9)),
    "particles": ({"kind": "fournier-forand", "index": 1.1, "slope": 3.58}, FournierForand(1.1, 3.58)),
}


@pytest.mark.parametrize("position", [[0.0, 0.0, 0.0], [0.3, -0.1, 0.0]], ids=["coaxial", "bistatic"])
@pytest.mark.parametrize("name", PHASES)
def test_single_scatter(name: str, position: list[float]) -> None:
    """z-scores of each slice over six seeds: 5 σ over 54 values is a chance of 3e-5 a case."""
    spec, phase = PHASES[name]
    scene = water(spec, 0.06, 0.14, **{"rig.laser.position_m": position})
    slices = slices_of(scene)
    nothing = np.zeros((len(slices.delay_s), 4, 4), dtype=np.float32)
    limits = Limits(most_samples=20_000)
    runs = np.stack(
        [
            render_remainder(scene, nothing, slices, 1e-9, seed, 0, component="single", limits=limits).light
            for seed in range(6)
        ]
    ).astype(float)
    expected = single_by_quadrature(scene, phase).sum(axis=(1, 2))
    got = runs.sum(axis=(2, 3))
    error = got.std(axis=0, ddof=1) / np.sqrt(6)
    assert np.all(error < 0.03 * expected)
    # The cells of the phase function hold their light, not their value: a thousandth at an angle.
    z = (got.mean(axis=0) - expected) / np.hypot(error, 0.001 * expected)
    assert np.abs(z).max() < 7.0  # t-distributed with 5 degrees of freedom: 5 σ of a normal


def test_multiple_scatter_by_an_independent_estimate() -> None:
    """Isotropic water, light scattered two to six times, against chains of points with evenly drawn distances (NumPy,
    double precision, no free paths, no end by chance); 4.5 σ over four gates. Events that fall close to the lamp weigh
    1/d²: one in a few runs widens a gate's error."""
    b, orders = 0.05, 6
    scene = water({"kind": "henyey-greenstein", "g": 0.0}, 0.0, b, **{"rig.delays.count": 4})
    slices = slices_of(scene)
    nothing = np.zeros((4, 4, 4), dtype=np.float32)
    runs = [
        render_remainder(
            scene, nothing, slices, 1e-9, seed, 0, component="multiple", limits=Limits(most_samples=80_000)
        ).light.astype(float).mean(axis=(1, 2))
        for seed in range(8)
    ]  # fmt: skip
    rng = np.random.default_rng(5)
    rig = gated_rig(scene)
    count, reach = 400_000, 5.5
    row, col = rng.uniform(-0.5, 3.5, (2, count))
    d = pixel_directions(rig.camera, row, col).T
    point, length, factor = np.zeros((count, 3)), np.zeros(count), np.ones(count)
    shown = np.zeros((len(slices.delay_s), count))
    for order in range(1, orders + 1):
        step = rng.uniform(0.0, reach, count)
        point, length, factor = point + d * step[:, None], length + step, factor * b * reach
        lamp = np.linalg.norm(point, axis=1)
        if order > 1:
            inside = point[:, 2] >= lamp * np.cos(rig.laser.illumination.half_angle_rad)
            value = inside * factor / (4 * np.pi) * np.exp(-b * (length + lamp)) / lamp**2
            shown += gate_response(scene, (length + lamp) * 1.36 / C) * value
        z, phi = rng.uniform(-1, 1, count), rng.uniform(0, 2 * np.pi, count)
        s = np.sqrt(1 - z * z)
        d = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)
    shown *= electrons_per_radiance(scene)
    expected, error = shown.mean(axis=1), shown.std(axis=1) / np.sqrt(count)
    got, ours_error = np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))
    assert np.all(error < 0.04 * expected) and np.median(ours_error / expected) < 0.04
    assert np.abs((got - expected) / np.hypot(error, ours_error)).max() < 4.5


@pytest.mark.parametrize("name", PHASES)
def test_cells_of_a_phase_function_keep_its_light(name: str) -> None:
    """Density integrates to one, follows the law within 2 %, and samples have its mean cosine."""
    mi = mitsuba()
    _, phase = PHASES[name]
    cells = PhaseCells.of(phase)
    psi = np.geomspace(1e-3, np.pi, 3000)
    forward = mi.Vector3f(0.0, 0.0, 1.0)
    turned = mi.Vector3f(mi.Float(np.sin(psi)), mi.Float(0.0), mi.Float(np.cos(psi)))
    value = np.asarray(cells.density(forward, turned).numpy(), dtype=float)
    assert np.abs(value / phase_density(phase, psi) - 1)[psi > 0.05].max() < 0.03
    count = 1 << 18
    random = mi.PCG32(count, 3)
    about = mi.Vector3f(0.6, 0.0, 0.8)
    drawn, density = cells.draw(about, random.next_uint32(), mi.Point2f(random.next_float32(), random.next_float32()))
    # A direction's density is that of its cell, but for those that rounding moves to the next one.
    same = np.isclose(np.asarray(density.numpy()), np.asarray(cells.density(about, drawn).numpy()), rtol=0.1)
    assert same.mean() > 0.97
    cosine = np.asarray(mi.Vector3f(drawn).numpy()).T @ np.array([0.6, 0.0, 0.8])
    from beambench.optics.water.phase_function import asymmetry

    assert cosine.mean() == pytest.approx(asymmetry(phase), abs=4.5 * cosine.std() / np.sqrt(count) + 1e-5)


def test_spread_of_multiple_scatter() -> None:
    """⟨R²⟩ after a path s is 2ℓ²(s/ℓ − 1 + e^(−s/ℓ)), ℓ = 1/b(1 − g): exact for any phase function. The loop's own ways and
    turns; 30 seeds of two phase functions and three paths: 4.5 σ over 6 means, and the z-scores of seeds spread as they should."""
    mi = mitsuba()
    import drjit as dr

    from beambench.optics.water.phase_function import asymmetry

    b, count, seeds = 2.0, 20_000, 30
    for phase in (HenyeyGreenstein(0.9), FournierForand(1.1, 3.58)):
        cells = PhaseCells.of(phase)
        length = 1 / (b * (1 - asymmetry(phase)))
        for s in (0.5, 2.0, 6.0):
            random = mi.PCG32(count * seeds, 9)
            d, p = mi.Vector3f(0.0, 0.0, 1.0), mi.Vector3f(0.0)
            left = mi.Float(s) + dr.zeros(mi.Float, count * seeds)

            def onward(random, d, p, left):  # type: ignore[no-untyped-def]
                step = dr.minimum(free_path(random.next_float32(), b), left)
                pair = mi.Point2f(random.next_float32(), random.next_float32())
                turned, _ = cells.draw(d, random.next_uint32(), pair)  # noqa: B023
                return random, turned, p + d * step, left - step

            state = (random, d + dr.zeros(mi.Vector3f, count * seeds), p + dr.zeros(mi.Vector3f, count * seeds), left)
            state = dr.while_loop(state, lambda random, d, p, left: left > 0.0, onward)
            r2 = np.asarray(dr.squared_norm(state[2]).numpy(), dtype=float).reshape(seeds, count)
            expected = 2 * length**2 * (s / length - 1 + np.exp(-s / length))
            z = (r2.mean(axis=1) - expected) / (r2.std() / np.sqrt(count))
            assert abs(z.mean()) * np.sqrt(seeds) < 4.5
            assert 0.4 < z.std(ddof=1) < 1.7  # χ² of 29 degrees of freedom, 4.5 σ
