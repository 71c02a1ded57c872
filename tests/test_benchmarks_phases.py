"""The suite of coarse delays: its results must not depend on the places of the echoes between two delays."""

from __future__ import annotations

import numpy as np
import pytest

from beambench.benchmarks.judges.bound import cramer_rao_bound
from beambench.benchmarks.scores.truth import failure_limit
from beambench.benchmarks.suites.stress import stressed
from beambench.benchmarks.suites.suite import load_suite
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.load import load_scene
from beambench.scenes.scene import Scene

LEVELS = [6.0, 8.0, 12.0, 16.0]


def at_level(level: float, phase: float = 0.0) -> list[Scene]:
    """The suite's scenes at a level, the scan moved by a share of its step."""
    suite = load_suite("stress-delay-step")
    scenes = [stressed(scene, [(suite.suite.stresses[0].axis, level)])[0] for _, scene in suite.scenes]
    moved = {"rig.delays.start_s": scenes[0].rig.delays.start_s + phase * scenes[0].rig.delays.step_s}  # type: ignore[union-attr]
    return [load_scene(scene, moved) for scene in scenes]


@pytest.mark.parametrize("level", LEVELS)
def test_every_phase_of_a_step_counts_alike(level: float) -> None:
    # |mean exp(2πi τ/step)| over the unmixed pixels: 1 where all lie at one phase, as on a wall square to the camera. A
    # failure rate cannot vary by more than a few times this as the scan is moved.
    scenes = at_level(level)
    phases = []
    for scene in scenes:
        capture = generate(scene, seed=101, capture_key=1)
        tau = 2 * capture["truth_range"].values[~capture["truth_mixed"].values] / C_M_PER_S
        phases.append(np.exp(2j * np.pi * tau / scene.rig.delays.step_s).mean())  # type: ignore[union-attr]
    assert abs(np.mean(phases)) < 0.05


@pytest.mark.parametrize("level", [8.0, 12.0])
def test_failure_rates_do_not_depend_on_where_the_scan_starts(level: float) -> None:
    rates = []
    for phase in (0.0, 0.25, 0.5, 0.75):
        failed = []
        for scene in at_level(level, phase):
            capture = generate(scene, seed=101, capture_key=1)
            bound = cramer_rao_bound(capture)
            truth = capture["truth_range"].values
            chosen = np.isfinite(truth) & ~capture["truth_mixed"].values
            found = run_estimator("parabola", hide_truth(capture))
            error = np.where(found["valid"].values, found["range"].values - truth, np.inf)[chosen]
            failed.append(np.mean(~(np.abs(error) <= failure_limit(bound.sigma[chosen], bound))))
        rates.append(float(np.mean(failed)))
    # 1,400 pixels fail one by one: a standard error of .013 at most; four rates spread by less than 4 of them. With a wall
    # square to the camera the same rates run from 0 to 1.
    assert max(rates) - min(rates) < 0.052
