"""Timing per pixel, shot and slice: the map of gate delays, jitter, long records, steep edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from beambench.generator.gated.gates import gate_tables
from beambench.generator.gated.view import view_of
from beambench.generator.generate import generate
from beambench.generator.rays.returns import Returns, render_stack
from beambench.generator.water.ramp import backscatter_electrons
from beambench.optics.correlation import waveforms
from beambench.optics.correlation.response import correlation, tabulate
from beambench.optics.likelihood.model import NoiseModel
from beambench.optics.likelihood.sample import pmf
from beambench.scenes.declared import declared_rig
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

WATER: dict[str, Any] = {
    "name": "murky", "index": {"kind": "explicit", "phase": 1.34, "group": 1.36}, "absorption_per_m": 0.1,
    "scattering_per_m": 0.3, "phase_function": {"kind": "fournier-forand", "index": 1.1, "slope": 3.58},
}  # fmt: skip


def murky(rows: int, cols: int, **more: Any) -> Scene:
    return load_scene("flat-wall", {"rig.camera.rows": rows, "rig.camera.cols": cols, "medium": WATER} | more)


@pytest.mark.parametrize("position", [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]], ids=["coaxial", "bistatic"])
@pytest.mark.parametrize("forward", [False, True])
def test_a_gate_that_opens_later_is_a_delay(position: list[float], forward: bool) -> None:
    """The water's light in a pixel whose gate opens by o later is that of delays larger by o: at the target, where a late gate
    would lose its nearest water, and at the lens; alone, and among pixels of other offsets that share its nodes."""
    scene = murky(1, 24, **{"rig.laser.position_m": position})
    phase, tables = scene.medium.phase, gate_tables(scene)
    assert phase is not None
    delay = np.arange(-2e-9, 30e-9, 1e-9)
    gate, one, wall = np.zeros(len(delay), np.int32), np.ones(len(delay)), np.full((1, 24), 3.0)
    offset = np.linspace(-1e-9, 1e-9, 24)[None]

    def ramp(late: np.ndarray[Any, Any] | None, shift: float = 0.0) -> np.ndarray[Any, Any]:
        found = backscatter_electrons(
            scene, view_of(scene), phase, tables, gate, delay + shift, one, wall, late, forward=forward
        )
        return found[:, 0].astype(np.float64)

    for shift in (-1e-9, -0.3e-9, 0.3e-9):
        assert np.allclose(ramp(np.full((1, 24), shift)), ramp(None, shift), rtol=1e-4, atol=1e-7 * ramp(None).max())
    mixed = ramp(offset)
    alone = np.stack([ramp(None, float(o))[:, p] for p, o in enumerate(offset[0])], axis=1)
    # Near the lens light falls as 1/path², and the cells' borders matter; beyond a metre they do not.
    late = delay > (8e-9 if any(position) else 4e-9)
    assert np.allclose(mixed[late], alone[late], rtol=2e-3, atol=1e-6 * alone.max())


def test_one_pixel_is_an_image() -> None:
    for rung in ("direct", "scatter", "full"):
        made = generate(murky(1, 1), seed=1, fidelity=rung, rtol=0.2, truth_electrons=True)  # type: ignore[arg-type]
        light = made["truth_electrons"].values
        assert np.isfinite(light).all() and light.max() > 0


def test_a_single_shot_jitters_with_its_returns() -> None:
    """Two returns of a step target move together with the jitter of the only shot, as the single return of a wall does."""
    pulse, gate = waveforms.GaussianPulse(1e-9), waveforms.RectangularGate(1e-10, 1.0)
    table, opening = tabulate(pulse, gate, 1e-5), 1e-10 * (np.arange(300) - 0.5)
    two = Returns(np.array([0, 2]), np.array([1.0, 0.5]), np.array([9e-9, 14e-9]), np.zeros(2))

    def centroid(jitter_s: float) -> float:
        out = np.empty((300, 1), np.float32)
        render_stack(two, table, opening, np.ones(300), np.array([jitter_s]), out)
        light = out[:, 0].astype(np.float64)
        return float(light @ opening / light.sum())

    # A gate that opens later sees the echo earlier.
    assert centroid(0.0) - centroid(2e-10) == pytest.approx(2e-10, rel=1e-3)


def test_a_long_record_is_as_sharp_at_its_end() -> None:
    """65,536 samples of a tenth of a nanosecond: R within 2e-4 of its peak everywhere, where single precision of one origin
    would miss by 5e-3."""
    pulse, gate = waveforms.GaussianPulse(2e-10), waveforms.RectangularGate(1e-10, 1.0)
    opening = 1e-10 * np.arange(65536)
    tau = np.array([0.1, 0.5, 0.97]) * opening[-1] + 0.37e-10
    out = np.empty((65536, 3), np.float32)
    single = Returns(np.arange(4), np.ones(3), tau, np.zeros(3))
    render_stack(single, tabulate(pulse, gate, 1e-5), opening, np.ones(65536), None, out)
    exact = correlation(pulse, gate, tau[None, :] - opening[:, None])
    assert np.abs(out - exact).max() < 2e-4 * exact.max()


@pytest.mark.parametrize(
    "gate",
    [
        {"kind": "trapezoidal", "width_s": 1e-8, "rise_s": 1e-11, "fall_s": 1e-11, "transmission": 1.0},
        {"kind": "trapezoidal", "width_s": 5e-9, "rise_s": 2e-11, "fall_s": 1e-9, "transmission": 1.0},
    ],
)
def test_declared_samples_keep_steep_edges(gate: dict[str, Any]) -> None:
    """Area and centroid of a gate whose edge is far shorter than the samples' step, read with straight lines between them."""
    rig = declared_rig(load_scene("flat-wall", {"rig.laser.pulse.fwhm_s": 5e-9, "rig.gates": [gate]}))
    told = rig["gates"][0]
    time = told["start_s"] + told["step_s"] * np.arange(len(told["value"]))
    value = np.array(told["value"])
    area = float(value.sum() * told["step_s"])
    exact = waveforms.gate_from_spec(gated_rig(load_scene("flat-wall", {"rig.gates": [gate]})).gates[0])
    grid = np.linspace(*waveforms.gate_support(exact), 400_001)
    shown = waveforms.gate_transmission(exact, grid)
    assert area == pytest.approx(waveforms.gate_area(exact), rel=1e-6)
    # .1 ps is .015 mm; point samples moved an edge by some 10 ps.
    assert float(value @ time / value.sum()) == pytest.approx(float(shown @ grid / shown.sum()), abs=1e-13)


def test_codes_are_rounded_as_the_likelihood_has_it() -> None:
    """A quarter DN per electron and no read noise: halves decide. Frequencies of 4096 × 16 codes against P(y | μ)."""
    mean = 3.0
    quiet = {
        "rig.camera.rows": 64, "rig.camera.cols": 64, "rig.ambient_e_per_s": 0.0, "rig.laser.pulse_energy_j": 1e-30,
        "rig.detector.dark_current_e_per_s": mean, "rig.detector.exposure_s": 1.0, "rig.detector.read_noise_e": 0.0,
        "rig.detector.gain_dn_per_e": 0.25, "rig.detector.offset_dn": 10.0, "rig.detector.prnu": 0.0,
        "rig.detector.dsnu_e": 0.0, "rig.delays.count": 16,
    }  # fmt: skip
    scene = load_scene("flat-wall", quiet)
    codes = generate(scene, seed=5)["counts"].values.ravel()
    detector = gated_rig(scene).detector
    model = NoiseModel(
        read_noise_e=0.0, gain_dn_per_e=0.25, offset_dn=10.0, adc_max_dn=2**detector.adc_bits - 1,
        full_well_e=detector.full_well_e,
    )  # fmt: skip
    chance = pmf(model, [mean])[0]
    found = np.bincount(codes, minlength=len(chance))[: len(chance)] / codes.size
    error = np.sqrt(chance * (1 - chance) / codes.size)
    assert np.abs(found - chance).max() < 5 * error.max()


def test_surfaces_and_gates_give_no_light_away() -> None:
    phong = {"kind": "phong", "diffuse_albedo": 0.7, "specular_albedo": 0.5, "exponent": 10.0}
    with pytest.raises(InputError, match="at most 1"):
        load_scene("flat-wall", {"target.0.material": phong})
    with pytest.raises(InputError, match="at most 1"):
        load_scene(
            "flat-wall", {"rig.gates": [{"kind": "sampled", "start_s": 0.0, "step_s": 1e-9, "value": [0, 55, 0]}]}
        )
