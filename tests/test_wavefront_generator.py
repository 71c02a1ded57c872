"""The forward model of wavefront sensors: photoelectrons, gate, phase, spots, and what is refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from beambench.generator.generate import GenerationWarning, generate
from beambench.generator.random import Stage
from beambench.generator.wavefront.cells import cell_errors, cells_for
from beambench.generator.wavefront.choose import predicted
from beambench.generator.wavefront.field import Pupils
from beambench.generator.wavefront.light import pedestal
from beambench.generator.wavefront.scintillation import irradiance_index, rytov_of
from beambench.generator.wavefront.spots import _residual, spot_image
from beambench.generator.wavefront.truth import Projector, slopes
from beambench.optics.lenslets.coherent import Detector, Lenslet, coherent_image
from beambench.optics.lenslets.gradients import mean_gradients, square
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.wavefront import wavefront_rig
from beambench.scenes.rigs.wavefront_geometry import dynamic_range_rad, lattice_of, pixel_angle_rad, range_eq26_m
from beambench.scenes.rigs.wavefront_turbulence import Flow, layers_of

RUNGS = ("geometric", "isolated", "coherent")
C = 299792458.0
STILL = {"rig.turbulence": {"kind": "none"}}
#: Light of phase screens is even: what propagation makes of it is tested in test_wavefront_propagation.py.
SCREENS = {"rig.propagation": "phase-screens"}
SMALL: dict[str, Any] = SCREENS | {
    "rig.lenslets.across": 6, "rig.pupil.diameter_m": 0.8e-3, "rig.pupil.modes": 10, "rig.camera.rows": 72, "rig.camera.cols": 72,
    "rig.frames.count": 1, "rig.frames.reference_exposures": 1,
}  # fmt: skip


def test_photoelectrons_of_a_lenslet_are_those_of_the_energy_it_receives() -> None:
    """E · splitters · ρ e^{−2ar} · T η λ/hc · d²/(πD²/4) · share of the pulse in the open gate, by a sum over the pulse."""
    scene = load_scene("gated-turbulence", {**SMALL, **STILL, "rig.frames.start_s": 34.0e-9})
    capture = generate(scene, seed=1, fidelity="geometric")
    index = declared_rig(scene)["medium"]["group_index"]
    sigma = 5e-9 / np.sqrt(8 * np.log(2))
    t = np.linspace(-8 * sigma, 8 * sigma, 200001)
    late = (2 * index * 4.0 + 0.6) / C + t - 34.0e-9
    share = np.exp(-0.5 * (t / sigma) ** 2)[(late >= 0) & (late <= 10e-9)].sum() / np.exp(-0.5 * (t / sigma) ** 2).sum()
    photons = 1e-10 * 0.25 * 0.25 * np.exp(-2 * 0.0445 * 4.0) * 532e-9 / (6.62607015e-34 * C)
    expected = photons * 0.95 * 0.25 * 150e-6**2 / (np.pi / 4 * 5e-3**2) * share
    assert 0.5 < share < 0.99
    np.testing.assert_allclose(
        capture["truth_flux"].values, expected, rtol=2e-4
    )  # the sum's steps and the table's 1e-5


@pytest.mark.parametrize("rung", RUNGS)
def test_a_lenslet_loses_no_light_but_its_far_tails(rung: str) -> None:
    """Of sinc² beyond a distance of x widths 1/π²x is lost on each side and axis: 1.3 % in all at the windows' 15 widths."""
    others = [[r, c] for r in range(6) for c in range(6) if (r, c) != (2, 2)]
    scene = load_scene(
        "gated-turbulence", {**SMALL, **STILL, "rig.lenslets.missing": others, "rig.detector.intensifier": None}
    )
    capture = generate(scene, seed=1, fidelity=rung, truth_electrons=True)
    dark = 0.1  # 100 electrons per second in a millisecond
    light = float((capture["truth_electrons"].values[0] - dark).sum())
    flux = float(capture["truth_flux"].values[0, 0])
    assert capture.sizes["lenslet"] == 1
    assert 0.98 * flux < light < 1.0005 * flux


@pytest.mark.parametrize("rung", RUNGS)
def test_a_slope_of_a_pixel_moves_every_spot_by_a_pixel(rung: str) -> None:
    """A tilt of a₂ rad rms over D is a slope of 4a₂/kD: of p/f it moves the image by one column. What enters and leaves at the
    borders, and lenslets outside the pupil, are the same plane wave."""
    slope = 17.8e-6 / 6.7e-3
    tilt = 2 * np.pi / 532e-9 * slope * 0.8e-3 / 4
    flat = load_scene("gated-turbulence", {**SMALL, **STILL})
    moved = load_scene("gated-turbulence", {**SMALL, **STILL, "rig.aberration": {"noll": [2], "rad": [tilt]}})
    one, two = (generate(s, seed=1, fidelity=rung, truth_electrons=True) for s in (flat, moved))
    a, b = (capture["truth_electrons"].values[0].astype(float) for capture in (one, two))
    # Float32 phases, and with interference the pistons of neighbours that a tilt changes.
    within = {"geometric": 1e-5, "isolated": 2e-3, "coherent": 0.2}[rung]
    assert np.abs(b[8:-8, 9:-8] - a[8:-8, 8:-9]).max() < within * a.max()
    np.testing.assert_allclose(two["truth_slope"].values[0, :, 0], slope, rtol=1e-9)
    np.testing.assert_allclose(two["truth_slope"].values[0, :, 1], 0.0, atol=1e-12)


def test_rungs_agree_on_a_flat_wave_but_for_interference() -> None:
    scene = load_scene("gated-turbulence", {**SMALL, **STILL})
    image = {
        rung: generate(scene, seed=1, fidelity=rung, truth_electrons=True)["truth_electrons"].values[0]
        for rung in RUNGS
    }
    top = float(image["geometric"].max())
    assert (
        np.abs(image["isolated"] - image["geometric"]).max() < 2e-3 * top
    )  # light beyond 2.5 pitches, 4-node quadrature
    assert 0.005 * top < np.abs(image["coherent"] - image["isolated"]).max() < 0.3 * top


def test_the_true_slope_is_the_gradient_averaged_over_the_lenslet() -> None:
    """Against integrals of the polynomials along the lenslets' edges; 8 samples a lenslet leave differences of 8⁻² of the
    polynomial's third derivative."""
    rng = np.random.default_rng(3)
    rad = rng.standard_normal(9)
    change = {"rig.aberration": {"noll": list(range(2, 11)), "rad": rad.tolist()}}
    scene = load_scene("gated-turbulence", {**STILL, **change, "rig.frames.count": 1})
    capture = generate(scene, seed=1)
    lattice = lattice_of(wavefront_rig(scene))
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    exact = mean_gradients(range(2, 11), centre, square(150e-6), 1.5e-3) @ rad * 532e-9 / (2 * np.pi)
    np.testing.assert_allclose(capture["truth_slope"].values[0], exact, atol=2e-3 * np.abs(exact).max())
    np.testing.assert_allclose(capture["truth_zernike"].values[0, :9], rad, atol=1e-9)
    np.testing.assert_allclose(capture["truth_zernike"].values[0, 9:], 0.0, atol=1e-9)


def test_a_mirror_doubles_the_phase_of_kolmogorov_turbulence() -> None:
    """Variance of tip and tilt: .4489 (D/r0)^{5/3} each (Noll 1976), four times that for a phase that counts twice. 240 values of
    400 frames, whose variance scatters by √(2/800): four standard errors are 20 %, a missing factor of 4 is 300 %."""
    scene = load_scene("gated-turbulence", {"rig.lenslets.across": 20, "rig.pupil.samples": 2, "rig.pupil.modes": 3})
    rig = wavefront_rig(scene)
    lattice = lattice_of(rig)
    project = Projector(lattice, rig.pupil.diameter_m, 3)
    pupils = Pupils(rig, lattice, 5, 7)
    found = np.array([project.coefficients(pupils.phase(frame, 4.0)[1:-1, 1:-1]) for frame in range(400)])
    expected = 4 * 0.4489 * (3.0 / 2.5) ** (5 / 3)
    assert abs((found**2).mean() / expected - 1) < 4 * np.sqrt(2 / 800)
    assert Stage.SCREEN == 20  # never renumbered


def test_the_gate_selects_the_mirror_and_the_phase_gathers_up_to_it() -> None:
    """Two partial mirrors, and a layer between them: the nearer one's light is flat, the farther one's passed
    (1 − ρ)² and the layer."""
    scene = load_scene(
        "gated-turbulence",
        {
            "target": [
                {"name": f"m{z}", "material": {"kind": "lambert", "albedo": 0.25}, "shape": {
                    "kind": "rectangle", "center_m": [0.0, 0.0, z], "width_m": 0.1, "height_m": 0.1, "tilt_x_deg": 0.0,
                    "tilt_y_deg": 0.0}} for z in (2.0, 4.0)
            ],
            **SCREENS, "medium.absorption_per_m": 0.0, "rig.frames.count": 2,
            "rig.frames.start_s": 15.12e-9, "rig.frames.step_s": 18.08e-9,
        },
    )  # fmt: skip
    capture = generate(scene, seed=2)
    near, far = capture["truth_flux"].values[:, 0]
    assert far / near == pytest.approx(0.75**2, rel=1e-3)
    assert np.abs(capture["truth_zernike"].values[0]).max() < 1e-9
    assert np.abs(capture["truth_zernike"].values[1]).max() > 0.1


def test_equal_seeds_give_equal_bits_and_frames_are_draws_of_their_own() -> None:
    scene = load_scene("gated-turbulence", {**SMALL, "rig.frames.count": 2})
    one, two, other = (generate(scene, seed=seed) for seed in (4, 4, 5))
    assert one.identical(two)
    assert not np.array_equal(one["counts"], other["counts"])
    assert not np.array_equal(one["truth_slope"][0], one["truth_slope"][1])


def test_a_frozen_flow_moves_the_wavefront() -> None:
    """A velocity of one lenslet per frame along x: what a lenslet saw, its neighbour at greater x sees in the next frame."""
    layers = [{"range_m": 3.0, "r0_m": 2.5e-3, "velocity_m_per_s": [1.5e-3, 0.0]}]
    change = {"rig.frames.count": 2, "rig.pupil.shape": "square", "rig.pupil.diameter_m": 1.5e-3}
    scene = load_scene("gated-turbulence", SCREENS | {"rig.turbulence": {"kind": "layers", "layers": layers}, **change})
    capture = generate(scene, seed=3)
    lattice = lattice_of(wavefront_rig(scene))
    slope = np.full((2, 20, 20, 2), np.nan)
    for frame in range(2):
        slope[frame, lattice.row, lattice.col] = capture["truth_slope"].values[frame]
    first, second = slope[0, 5:15, 5:14], slope[1, 5:15, 6:15]
    np.testing.assert_allclose(second, first, atol=1e-9)


def test_scattered_light_of_a_long_gate() -> None:
    """b β(π) c Δt/2n of radiance per fluence from a gate of Δt far longer than the pulse, without attenuation to speak of."""
    water = {
        "name": "w", "index": {"kind": "explicit", "phase": 1.33, "group": 1.35}, "absorption_per_m": 0.0,
        "scattering_per_m": 1e-4, "phase_function": {"kind": "henyey-greenstein", "g": 0.9},
    }  # fmt: skip
    scene = load_scene(
        "gated-turbulence", {"medium": water, "rig.gate.width_s": 10e-9, "rig.laser.pulse.fwhm_s": 0.1e-9}
    )
    found = float(pedestal(scene, np.array([15e-9]))[0])
    beta = (1 - 0.9**2) / (4 * np.pi * (1 + 0.9**2 + 2 * 0.9) ** 1.5)
    radiance = 1e-10 * 0.25 / (np.pi / 4 * 5e-3**2) * 1e-4 * beta * C * 10e-9 / (2 * 1.35)
    radiance /= 1.33**2  # L/n² is the same in the air of the array
    electrons = radiance * 150e-6**2 * (17.8e-6 / 6.7e-3) ** 2 * 0.95 * 0.25 * 532e-9 / (6.62607015e-34 * C)
    assert found == pytest.approx(electrons, rel=0.02)  # 400 nodes of the range, e^{−2cz}
    # The same gate, its zero of time declared elsewhere: the light is where it was.
    for t0 in (5e-9, 14.9e-9):
        moved = scene.model_copy(update={"rig": wavefront_rig(scene).model_copy(update={"t0_s": t0})})
        assert float(pedestal(moved, np.array([15e-9 - t0]))[0]) == pytest.approx(found, rel=1e-3)


def test_what_follows_from_pitch_focus_and_pixel() -> None:
    """Guo et al. 2017, Eq. 26, 33 and 34, and the pitch of 8.427 px."""
    rig = wavefront_rig(load_scene("gated-turbulence"))
    assert pixel_angle_rad(rig) == pytest.approx(2.657e-3, rel=2e-4)
    assert dynamic_range_rad(rig) == pytest.approx(11.194e-3, rel=1e-4)
    assert rig.lenslets.pitch_m / rig.camera.pixel_pitch_m == pytest.approx(8.427, abs=5e-4)
    assert range_eq26_m(2 * 1.36 * 4.0 / C, 1.36) == pytest.approx(4.0)


def test_more_flow_is_more_turbulence_by_construction() -> None:
    strength = [
        sum(layer.r0_m ** (-5 / 3) for layer in layers_of(Flow(flow_l_per_min=flow))) for flow in (0, 10, 20, 30, 40)
    ]
    assert strength[0] == 0 and np.all(np.diff(strength) > 0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rig.lenslets.missing": [[40, 1]]}, "outside the array"),
        ({"rig.pupil.diameter_m": 1e-4}, "No lenslet"),
        ({"rig.camera.pixel_pitch_m": 60e-6}, "too few pixels"),
        ({"rig.lenslets.offset_m": [1e-3, 0.0]}, "outside the image"),
        ({"rig.bench.beam_diameter_m": 2e-3}, "does not fill"),
        ({"target.0.shape.tilt_y_deg": 5.0}, "square to it"),
        ({"target.0.shape.width_m": 4e-3}, "does not cover"),
        ({"rig.lenslets.preset": "other"}, "not allowed"),
        ({"rig.lenslets.pitch_m": 300e-6}, "not allowed"),
    ],
)
def test_an_impossible_rig_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_scene("gated-turbulence", change)


def test_an_impossible_rung_is_refused() -> None:
    scene = load_scene("gated-turbulence", {**SMALL, "rig.lenslets.rotation_deg": 10.0})
    with pytest.raises(InputError, match="parallel to the pixels"):
        generate(scene, seed=1, fidelity="coherent")
    with pytest.raises(InputError, match="not built"):
        generate(scene, seed=1, fidelity="direct")
    assert np.isfinite(generate(scene, seed=1, fidelity="geometric")["truth_slope"]).all()


def _error_of(seed: int) -> tuple[dict[str, float], dict[str, float], float]:
    """(predicted error of each rung, that of the scene's own image, a limit) of a random strength of turbulence."""
    rng = np.random.default_rng(seed)
    layer = {"range_m": 3.0, "r0_m": float(10 ** rng.uniform(-3.3, -1.5))}
    change = {
        **SMALL,
        "rig.turbulence": {"kind": "layers", "layers": [layer]},
        "rig.lenslets.across": 8,
        "rig.frames.count": 1,
    }
    scene = load_scene("gated-turbulence", change)
    rig = wavefront_rig(scene)
    phase = Pupils(rig, lattice_of(rig), seed, 1).phase(0, 4.0)
    lit = lattice_of(rig, every=True)
    image = {rung: spot_image(rig, lit, np.exp(1j * phase), 1.0, rung) for rung in RUNGS}
    whole = float(np.sqrt((image["coherent"] ** 2).sum()))
    own = {rung: float(np.sqrt(((image[rung] - image["coherent"]) ** 2).sum())) / whole for rung in RUNGS}
    return predicted(scene), own, float(10 ** rng.uniform(-2, -0.5))


def _verdicts(seeds: range) -> tuple[float, float]:
    """(share of scenes whose chosen rung is within the limit, share where it is the cheapest that is)."""
    within, cheapest = [], []
    for seed in seeds:
        guess, own, limit = _error_of(seed)
        rung = next(rung for rung in RUNGS if guess[rung] <= limit)
        within.append(own[rung] <= limit)
        cheapest.append(rung == next(rung for rung in RUNGS if own[rung] <= limit))
    return float(np.mean(within)), float(np.mean(cheapest))


def test_auto_takes_the_cheapest_rung_that_passes() -> None:
    within, cheapest = _verdicts(range(6))
    assert within >= 0.8 and cheapest >= 0.6
    scene = load_scene("gated-turbulence", SMALL)
    capture = generate(scene, seed=1, fidelity="auto", rtol=1e-4)
    assert json.loads(capture.attrs["fidelity"])["rung"] == "coherent"
    with pytest.raises(InputError, match="turned against"):
        generate(load_scene("gated-turbulence", {**SMALL, "rig.lenslets.rotation_deg": 10.0}), seed=1, fidelity="auto")


@pytest.mark.slow
def test_auto_is_right_in_forty_scenes(long_run: None) -> None:
    """Within the limit in 95 % and the cheapest that is in 80 % of scenes."""
    within, cheapest = _verdicts(range(100, 140))
    assert within >= 0.95 and cheapest >= 0.8


@pytest.mark.parametrize("reference", ["general sum", "lenslets one by one"])
def test_the_lattice_sum_is_the_direct_one(reference: str) -> None:
    """6 × 6 lenslets of d/r0 = .14 to .6, `coherent` against the sum at Gauss-Legendre nodes in double precision, `isolated`
    against the light of each lenslet alone: rms over rms below 1 %, of which .5 % is the direct sum's quadrature."""
    scene = load_scene("gated-turbulence", SMALL)
    rig = wavefront_rig(scene)
    lit = lattice_of(rig, every=True)
    lenslet = Lenslet(150e-6, 6.7e-3, 532e-9)
    middle = 35.5 * 17.8e-6
    detector = Detector((72, 72), 17.8e-6, (-middle, -middle))
    centre = np.stack([lit.col_px - 35.5, lit.row_px - 35.5], axis=1) * 17.8e-6
    for strength in (1.0, 4.0):
        field = np.exp(1j * strength * Pupils(rig, lattice_of(rig), 3, 1).phase(0, 4.0))
        tilt = slopes(field, lit, rig.wavelength_m)
        u = _residual(rig, lit, field, tilt)
        if reference == "general sum":
            want = coherent_image(u, tilt, centre, lenslet, detector, reach_m=2.5 * 150e-6)
            got = spot_image(rig, lit, field, 1.0, "coherent")
        else:
            want = sum(
                coherent_image(
                    u[i : i + 1], tilt[i : i + 1], centre[i : i + 1], lenslet, detector, reach_m=2.5 * 150e-6
                )
                for i in range(len(u))
            )
            got = spot_image(rig, lit, field, 1.0, "isolated")
        want = want / 150e-6**2
        assert np.sqrt(((got - want) ** 2).sum() / (want**2).sum()) < 0.01
        assert np.abs(got - want).max() < 0.02 * want.max()


def test_cells_follow_from_the_strength_of_the_turbulence() -> None:
    """A flat wave needs few cells, d/r0 = .6 more than the pupil has samples: then its own are taken, and the capture says so. The
    predicted error is that of the scene's own lenslets and draws within a factor of 2."""
    still, strong = (
        load_scene("gated-turbulence", SMALL | change)
        for change in (STILL, {"rig.turbulence": {"kind": "layers", "layers": [{"range_m": 3.0, "r0_m": 2.5e-4}]}})
    )
    assert cells_for(wavefront_rig(still), 4.0, "coherent", 1e-3)[0] == 2
    cells, error = cells_for(wavefront_rig(strong), 4.0, "coherent", 1e-3)
    assert cells == 8 and error > 1e-3
    assert list(cell_errors(wavefront_rig(strong), 4.0, "coherent")) == [2, 4, 8]
    capture = generate(strong, seed=1, fidelity="coherent", rtol=1e-3)
    listed = {line["name"]: line for line in json.loads(capture.attrs["fidelity"])["effects"]}
    assert listed["phase finer than a lenslet's cells"]["predicted_relative_size"] == error
    assert "8 a side" in listed["phase finer than a lenslet's cells"]["basis"]
    fine = wavefront_rig(load_scene("gated-turbulence", {
        **SMALL, "rig.pupil.samples": 32, "rig.turbulence": {"kind": "layers", "layers": [{"range_m": 3.0, "r0_m": 2.5e-4}]},
    }))  # fmt: skip
    field = np.exp(1j * Pupils(fine, lattice_of(fine), 9, 1).phase(0, 4.0))
    lit = lattice_of(fine, every=True)
    whole, coarse = (spot_image(fine, lit, field, 1.0, "coherent", cells=n) for n in (32, 8))
    own = float(np.sqrt(((coarse - whole) ** 2).sum() / (whole**2).sum()))
    assert 0.5 < error / own < 2.0


def test_scintillation_is_listed_with_its_size() -> None:
    """Rytov's variance of two passes of one layer in closed form, and its effect in the catalogue with a warning; still water has
    none. Andrews' index of irradiance is Rytov's variance where weak, and 1 within a third where strong."""
    assert irradiance_index(1e-3) == pytest.approx(1e-3, rel=2e-3)
    assert 1.0 < irradiance_index(1e4) < 1.4
    scene = load_scene("gated-turbulence", SMALL)
    n = declared_rig(scene)["medium"]["phase_index"]
    k = 2 * np.pi * n / 532e-9
    one, two = (5.318 * (way / (k * 2.5e-3**2)) ** (5 / 6) for way in (3.0, 5.0))
    found = rytov_of(wavefront_rig(scene), 4.0, scene.medium)
    assert found == pytest.approx((np.sqrt(one) + np.sqrt(two)) ** 2, rel=1e-3)
    assert rytov_of(wavefront_rig(scene), 2.0, scene.medium) == 0.0  # the layer lies behind the reflector
    with pytest.warns(GenerationWarning, match="scintillation is left out"):
        capture = generate(scene, seed=1)
    listed = {line["name"]: line for line in json.loads(capture.attrs["fidelity"])["effects"]}
    assert listed["scintillation"]["predicted_relative_size"] == pytest.approx(np.sqrt(irradiance_index(found)))
    still = generate(load_scene("gated-turbulence", SMALL | STILL), seed=1)
    effects = {line["name"]: line for line in json.loads(still.attrs["fidelity"])["effects"]}
    assert effects["scintillation"]["predicted_relative_size"] == 0.0


def test_a_wavefront_that_its_samples_cannot_hold_is_refused() -> None:
    """At 4 samples of 150 µm a slope of 8 mrad is 3.5 rad from sample to sample: its field is that of −6.2 mrad."""
    diameter = wavefront_rig(load_scene("gated-turbulence")).pupil.diameter_m
    for samples, refused in ((8, False), (4, True)):
        change = {
            "rig.turbulence": {"kind": "none"}, "rig.pupil.samples": samples,
            "rig.aberration": {"noll": [2], "rad": [2 * np.pi / 532e-9 * 8e-3 * diameter / 4]},
        }  # fmt: skip
        if not refused:
            found = generate(load_scene("gated-turbulence", change), seed=1)["truth_slope"].values[..., 0]
            np.testing.assert_allclose(found, 8e-3, rtol=1e-3)
            continue
        with pytest.raises(InputError, match="half a turn"):
            generate(load_scene("gated-turbulence", change), seed=1)
