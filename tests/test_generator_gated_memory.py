"""Memory of a stack whose target the slices hardly show: rays are traced block by block, and not shared out by what nobody sees."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from beambench.generator.gated import sub_pixels
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

_WATER = {
    "name": "water", "index": {"kind": "explicit", "phase": 1.335, "group": 1.357}, "absorption_per_m": 0.02,
    "scattering_per_m": 0.04, "phase_function": {"kind": "henyey-greenstein", "g": 0.1},
}  # fmt: skip
_CODE = """
import json, sys
from beambench.benchmarks.checks.attempts import peak_memory
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene
generate(load_scene("flat-wall", json.loads(sys.argv[1])), seed=1, fidelity=sys.argv[2])
print(peak_memory())
"""


def _delays(*values_s: float) -> dict[str, Any]:
    return {"rig.delays": {"kind": "listed", "values_s": list(values_s), "repeats": 1, "laser_off": 0}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "fidelity"),
    [(_delays(0.0, 1e-9, 30e-9, 31e-9), "direct"), (_delays(5e-9, 40e-9, 41e-9) | {"medium": _WATER}, "scatter")],
)
def test_a_target_in_the_tail_of_the_gates_takes_no_more_memory(changes: dict[str, Any], fidelity: str) -> None:
    """128 × 128 pixels took 10.7 GB with the first, and more than 12 with the second."""
    given = json.dumps({"rig.camera.rows": 128, "rig.camera.cols": 128, **changes})
    done = subprocess.run([sys.executable, "-c", _CODE, given, fidelity], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 900e6


def test_blocks_of_rays_change_no_count(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene("step", {"rig.camera.rows": 24, "rig.camera.cols": 24, "rig.camera.pixel_pitch_m": 6e-5})
    whole = generate(scene, seed=1)
    monkeypatch.setattr(sub_pixels, "MOST_RAYS", 500)
    blocks = generate(scene, seed=1)
    assert all(np.array_equal(whole[name].values, blocks[name].values, equal_nan=True) for name in whole.data_vars)
