"""Multiply scattered light of the `full` rung to 1 %, against a walk of photons that shares no physics with it (`_walk`).

What this can see: X is the sum over all slices of the mean pixel's multiply scattered light, P that of the walk, each the mean of
16 independent batches. β = X/P − 1 has a standard error σ_β of at most .2 % (else the test fails), and |β| ≤ 3σ_β is asked. A bias
of 1 % lies at 5σ_β or more and is refused in at least 97.7 % of draws; one of .33 % lies at 1.7 and would mostly pass. So what is
shown is that the sum has no bias of 1 %. In `wall` about 1 % of that sum lies before the echo, so single slices are asked
as well: |z| ≤ 4.5 with standard errors of at most 2 % (.1 to .8 % mostly), so that 10 % in any one of them would be seen.
Nothing is asked of differences between pixels, of curved or several surfaces, or of other laws of reflection than Lambert's.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import trapezoid

from beambench.benchmarks.fidelity.bias import Bias
from beambench.scenes.scene import Scene

from ._gate_closed_form import C
from ._lit_wall import lit_wall, remainder
from ._walk import walked
from ._walk_phase import Float, fournier_forand, henyey_greenstein

#: Largest standard error of the ratio; a bias of 1 % then lies at five of them.
MOST_SIGMA = 2e-3

GEOMETRIES: dict[str, dict[str, Any]] = {
    # The wall 3 m away, the lamp .3 m beside the camera, gates from before the wall's echo to after it.
    "wall": {},
    # Lamp and camera at one point, and no wall within the paths of the gates.
    "water": {
        "target.0.shape.center_m": [0.0, 0.0, 9.0], "rig.laser.position_m": [0.0, 0.0, 0.0],
        "rig.delays.start_s": 2.0 * 1.36 / C, "medium.scattering_per_m": 0.8,
    },
    # A wall at 40° from 2 to 3.4 m, the lamp beside and below the camera.
    "oblique": {
        "target.0.shape.center_m": [0.0, 0.0, 2.5], "target.0.shape.tilt_x_deg": 40.0,
        "rig.laser.position_m": [0.2, 0.15, 0.0], "rig.delays.start_s": 3.6 * 1.36 / C, "rig.delays.step_s": 0.4 * 1.36 / C,
    },
}  # fmt: skip

PHASES: dict[str, tuple[dict[str, Any], Callable[[Float], Float]]] = {
    "hg-0.8": ({"kind": "henyey-greenstein", "g": 0.8}, partial(henyey_greenstein, 0.8)),
    "hg-0.95": ({"kind": "henyey-greenstein", "g": 0.95}, partial(henyey_greenstein, 0.95)),
    # Mean cosine .93.
    "ff": ({"kind": "fournier-forand", "index": 1.1, "slope": 3.58}, partial(fournier_forand, 1.1, 3.58)),
}


def scene_of(geometry: str, phase: str) -> Scene:
    """A wall (60 m wide: without end for these paths) in water of b = .5/m, seen by 4×4 pixels of 36°."""
    wide = {"target.0.shape.width_m": 60.0, "target.0.shape.height_m": 60.0, "rig.camera.focal_length_m": 8e-5}
    return lit_wall(0.5, 0.8, **wide, **{"medium.phase_function": PHASES[phase][0]}, **GEOMETRIES[geometry])


def ours_of(scene: Scene, samples: int, batches: int) -> Float:
    """Photoelectrons (batches, slices) of the mean pixel as a capture has them: the share "multiple" of all light."""
    runs = (remainder(scene, seed, samples, parts=True).parts["multiple"] for seed in range(batches))
    return np.stack([run.mean(axis=(1, 2), dtype=float) for run in runs])


def ratio_of(ours: Float, theirs: Float) -> Bias:
    """Ours over theirs less one, and its standard error, of two samples of independent batches."""
    x, p = ours.mean(), theirs.mean()
    error = [v.std(ddof=1) / np.sqrt(len(v)) / v.mean() for v in (ours, theirs)]
    return Bias(float(x / p - 1.0), float(x / p * np.hypot(*error)))


def agrees(found: Bias) -> bool:
    """Whether no bias is seen, and one of 1 % would have been."""
    return found.sigma <= MOST_SIGMA and found.seen <= 0.01 and abs(found.value) <= 3.0 * found.sigma


def check(geometry: str, phase: str, samples: int, photons: int, most_sigma: float = MOST_SIGMA) -> None:
    """Sixteen batches of ours and of the walk's: the sum agrees, 1 % more or less of ours does not, and every slice agrees."""
    scene = scene_of(geometry, phase)
    start = time.process_time()
    ours = ours_of(scene, samples, 16)
    middle = time.process_time()
    theirs = walked(scene, PHASES[phase][1], photons, 16)
    found = ratio_of(ours.sum(axis=1), theirs.sum(axis=1))
    cost = f"{middle - start:.0f} + {time.process_time() - middle:.0f} CPU s"
    print(f"{geometry} {phase}: {1.0 + found.value:.4f} ± {found.sigma:.4f}, {cost}")
    assert agrees(found) and found.sigma <= most_sigma, found
    for scale in (0.99, 1.01):
        assert not agrees(ratio_of(scale * ours.sum(axis=1), theirs.sum(axis=1))), f"{scale} is not seen"
    single = [ratio_of(one, two) for one, two in zip(ours.T, theirs.T, strict=True)]
    print(" ".join(f"{1.0 + s.value:.3f}±{s.sigma:.3f}" for s in single))
    assert max(s.sigma for s in single) <= 0.02, single
    assert max(abs(s.value) / s.sigma for s in single) < 4.5, single


def test_multiple_scattering_to_a_per_cent() -> None:
    check("wall", "ff", 8192, 40_000)


@pytest.mark.slow
def test_multiple_scattering_of_water_alone_to_a_per_cent(long_run: None) -> None:
    check("water", "hg-0.8", 49_152, 130_000)


@pytest.mark.slow
@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_multiple_scattering_in_all_of_them(geometry: str, phase: str, request: pytest.FixtureRequest) -> None:
    """Every geometry with every phase function, σ_β ≤ .15 %: a bias of .7 % would be refused in 95 % of draws."""
    if "slow" not in str(request.config.getoption("-m")):
        pytest.skip(f"ten minutes: pytest -m slow {Path(__file__).name}; a shorter part of it just ran")
    check(geometry, phase, 40_960, 300_000 if geometry == "water" else 150_000, 1.5e-3)


def test_phase_functions_of_the_walk_are_what_they_are_called() -> None:
    """One over the sphere, the mean cosine g, and over .9 for two of the three."""
    theta = np.geomspace(1e-12, np.pi, 400_000)
    for name, g in (("hg-0.8", 0.8), ("hg-0.95", 0.95), ("ff", 0.93)):
        even = 2 * np.pi * np.sin(theta) * PHASES[name][1](theta)
        assert trapezoid(even, theta) == pytest.approx(1.0, abs=1e-4)
        assert trapezoid(even * np.cos(theta), theta) == pytest.approx(g, abs=1e-3)
