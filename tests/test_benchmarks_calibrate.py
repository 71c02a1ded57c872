"""The simulated calibration: records of the true waveforms, and the declared rig that follows from them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beambench.benchmarks.judges.calibrate import Calibrations, calibrated_rig
from beambench.benchmarks.judges.records import record_gate, record_pulse
from beambench.benchmarks.suites.spec import Calibration
from beambench.benchmarks.suites.suite import Cell, cells_of, load_suite
from beambench.estimators.calibration.response import gate_from_scan, pulse_from_trace
from beambench.estimators.response import correlate_samples
from beambench.optics.constants import C_M_PER_S
from beambench.optics.correlation import response as correlation
from beambench.optics.correlation import waveforms
from beambench.scenes.declared import declared_rig
from beambench.scenes.load import load_scene

STEP = 1e-11
GAUSSIAN = waveforms.GaussianPulse(1e-9)
GATES = {
    "rectangular": waveforms.RectangularGate(1.0037e-9, 1.0),  # closes between two steps
    "trapezoidal": waveforms.TrapezoidalGate(1e-9, 3e-10, 3e-10, 1.0),
    "gaussian": waveforms.GaussianGate(1e-9, 0.9),
    "exponential": waveforms.ExponentialGate(6e-10, 3e-10, 0.8),
}


def shift_mm(pulse: waveforms.Pulse, gate: waveforms.Gate, photons: tuple[float, float], seed: int) -> float:
    """By how much the recovered R lies off its closed form, as a range sees it: least squares in height and place."""
    low, high = correlation.correlation_support(pulse, gate)
    u = np.linspace(low, high, 1000)
    basis = np.stack([correlation.correlation(pulse, gate, u), -correlation.correlation_slope(pulse, gate, u)], axis=1)
    first, second = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    time, trace = record_pulse(pulse, STEP, photons[0], first)
    delay, scan = record_gate(gate, STEP, photons[1], second)
    found = correlate_samples(
        pulse_from_trace(float(time[0]), STEP, trace),
        gate_from_scan(float(delay[0]), STEP, scan, transmission=float(gate.transmission)),  # type: ignore[union-attr]
    )
    height, moved = np.linalg.lstsq(basis, found(u)[0], rcond=None)[0]
    return float(500 * C_M_PER_S * moved / height)


def calibration(photons: float, seed: int = 1) -> Calibration:
    return Calibration(pulse_photoelectrons=photons, gate_photoelectrons=photons / 100, seed=seed)


def test_records_hold_the_stated_light() -> None:
    rng = np.random.default_rng(1)
    time, counts = record_pulse(waveforms.ExponentialPulse(1e-9, 0.8e-9), 2e-11, 1e6, rng)
    dark = 1e-3 * counts.max() * counts.size
    assert counts.sum() - dark == pytest.approx(1e6, abs=5 * 1e3 + 0.1 * dark)  # 5 standard errors of a Poisson sum
    # The clock's zero is the centroid: its standard error is σ/√N, 1 ns/1000; the dark level adds its own.
    light = counts - 1e-3 * counts.max()
    assert (light * time).sum() / light.sum() == pytest.approx(0.0, abs=2e-11)
    delay, scan = record_gate(waveforms.RectangularGate(2e-9, 0.8), 2e-11, 1e4, rng)
    inside = (delay > 1e-10) & (delay < 1.9e-9)
    assert scan[inside].mean() == pytest.approx(0.8 * 1e4 * 1.001, rel=5 / np.sqrt(8e3 * inside.sum()))
    assert scan[delay < -1e-10].mean() == pytest.approx(8.0, rel=0.2)


def test_a_better_calibration_comes_nearer_to_the_truth() -> None:
    scene = load_scene("relief-tank")
    declared = json.dumps(declared_rig(scene))
    exact = correlate_samples(json.loads(declared)["pulse"], json.loads(declared)["gates"][0])

    def error(photons: float) -> float:
        shifts = []
        for seed in range(12):
            rig = json.loads(calibrated_rig(scene, declared, calibration(photons, seed)))
            found = correlate_samples(rig["pulse"], rig["gates"][0])
            shifts.append(found.centroid_s - exact.centroid_s)
        return float(np.sqrt(np.mean(np.square(shifts))))

    poor, good = error(1e4), error(1e7)
    assert good < poor / 3  # noise falls by √1000; what remains is the cut of the support and the smoothing
    assert good < 5e-12


def test_only_pulse_and_gates_change_and_equal_seeds_agree() -> None:
    scene = load_scene("flat-wall")
    before = declared_rig(scene)
    text = json.dumps(before)
    once, again = (calibrated_rig(scene, text, calibration(1e5)) for _ in range(2))
    assert once == again
    assert once != calibrated_rig(scene, text, calibration(1e5, seed=2))
    after = json.loads(once)
    for name in before:
        if name not in ("pulse", "gates"):
            assert after[name] == json.loads(text)[name]
    pulse = after["pulse"]
    assert sum(pulse["value"]) * pulse["step_s"] == pytest.approx(1.0, rel=1e-6)
    assert len(after["gates"]) == len(before["gates"])


def test_the_true_waveform_is_recorded_not_the_declared_one() -> None:
    # A wrong pulse is declared; a calibration recovers the true one.
    scene = load_scene("flat-wall", {"declared": {"laser.pulse.fwhm_s": 3e-9}})
    wrong = declared_rig(scene)
    found = json.loads(calibrated_rig(scene, json.dumps(wrong), calibration(1e6)))
    true = declared_rig(load_scene("flat-wall"))
    width = [correlate_samples(r["pulse"], r["gates"][0]).variance_s2 ** 0.5 for r in (true, found, wrong)]
    assert width[1] == pytest.approx(width[0], rel=0.02)
    assert width[2] > 1.5 * width[0]


@pytest.mark.parametrize("name", GATES)
@pytest.mark.parametrize("pulse", [GAUSSIAN, waveforms.ExponentialPulse(6e-10, 5e-10)], ids=["gaussian", "tailed"])
def test_a_calibrated_response_is_not_displaced(name: str, pulse: waveforms.Pulse) -> None:
    # Half a step of 10 ps is .75 mm. What may be left without noise is the curvature of a Gaussian's edge.
    assert abs(shift_mm(pulse, GATES[name], (1e15, 1e13), 0)) < 0.03
    # At a suite's photons: its mean over draws is within 3 standard errors of none.
    found = np.array([shift_mm(pulse, GATES[name], (1e5, 1e3), seed) for seed in range(120)])
    assert abs(found.mean()) < 3 * found.std(ddof=1) / np.sqrt(found.size)


def test_the_gates_place_is_as_uncertain_as_its_counts_say() -> None:
    # √(.625 h/(n w))/s: h 10 ps, n 1e3, the rise .3 ns long, w half of its middle half: 2.74 ps, .41 mm. A standard
    # deviation of 100 draws is known to 7 %, and the plateau's height adds some: 3 of its errors either way.
    found = [shift_mm(GAUSSIAN, GATES["trapezoidal"], (1e12, 1e3), seed) for seed in range(100)]
    expected = 500 * C_M_PER_S * np.sqrt(0.625 * STEP / (1e3 * 0.075e-9)) * 0.3e-9
    assert expected == pytest.approx(0.41, abs=0.01)
    assert np.std(found, ddof=1) == pytest.approx(expected, rel=0.22)


@pytest.mark.parametrize("phase", [0.0, 0.2, 0.5, 0.7])
def test_the_scans_phase_does_not_move_the_gate(phase: float) -> None:
    # A laboratory's steps do not meet the edge: a jump seen through hats at any phase is put back within .02 mm.
    gate = GATES["exponential"]
    delay = (np.arange(-100, 1200) + phase) * STEP
    edge = np.concatenate([[delay[0] - STEP], delay, [delay[-1] + STEP]])
    seen = sum(np.diff(part.upper2(edge), n=2) for part in waveforms.gate_parts(gate)) / STEP**2
    found = gate_from_scan(0.0, STEP, np.asarray(seen), transmission=0.8)
    top = int(np.argmax(np.asarray(found["value"]) > 0.4))  # the first sample past the half height, of either
    true = float(delay[int(np.argmax(np.asarray(seen) > 0.4))])
    assert (found["start_s"] + top * STEP - true) * 500 * C_M_PER_S == pytest.approx(0.0, abs=0.02)


def test_each_scene_and_seed_has_its_own_calibration_and_levels_share_it() -> None:
    suite = {
        "suite": "s", "estimators": ["peak"], "seeds": {"test": [1, 2]}, "conditions": ["calibrated"],
        "scenes": [{"scene": "flat-wall"}, {"scene": "flat-wall", "name": "again"}],
        "stresses": [{"axis": "photons", "values": [1.0, 0.1]}],
        "calibration": {"pulse_photoelectrons": 1e5, "gate_photoelectrons": 1e3},
    }  # fmt: skip
    cells = cells_of(load_suite(suite))

    def drawn(cell: Cell, source: Calibrations) -> str:
        rig = json.loads(source.declared(cell, json.dumps(declared_rig(cell.scene))))
        return json.dumps([rig["pulse"], rig["gates"]])

    source = Calibrations(load_suite(suite).suite.calibration or calibration(1e5))
    found = {(cell.scene_name, cell.seed, cell.level): drawn(cell, source) for cell in cells}
    by_draw: dict[str, set[tuple[str, int]]] = {}
    for (name, seed, _), text in found.items():
        by_draw.setdefault(text, set()).add((name, seed))
    assert len(found) == 12
    assert sorted(by_draw.values(), key=str) == [{("again", 1)}, {("again", 2)}, {("flat-wall", 1)}, {("flat-wall", 2)}]
    # Keyed by name, not by order: in reverse order all are the same. Another seed of the suite changes them.
    again, other = Calibrations(calibration(1e5, seed=0)), Calibrations(calibration(1e5, seed=1))
    assert {(c.scene_name, c.seed, c.level): drawn(c, again) for c in reversed(cells)} == found
    assert drawn(cells[0], other) != drawn(cells[0], again)


def test_a_stress_that_a_calibration_takes_away_is_swept_without_it() -> None:
    assert load_suite("stress-gate").suite.conditions == ("matched",)
