"""The example of CONTRIBUTING.md runs unchanged, and its results are as stated there."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

from beambench.benchmarks.laws.check import check_laws
from beambench.captures.hide import hide_truth
from beambench.generator.generate import generate
from beambench.optics.constants import C_M_PER_S
from beambench.scenes.load import load_scene

from ._guide import block


def test_the_example_estimates(project: Path, tmp_path: Path) -> None:
    code = block(project, "an estimator", "python")
    file = tmp_path / "half_sum.py"
    file.write_text(
        code.replace("from ..", "from beambench.estimators.").replace(
            "from .tools", "from beambench.estimators.gated.tools"
        ),
        encoding="utf-8",
    )
    spec = importlib.util.spec_from_file_location("half_sum", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    capture = generate(load_scene("flat-wall", {"rig.pulses_per_slice": 2000}), seed=1)
    found = module.half_sum(hide_truth(capture))
    assert found["valid"].values.mean() > 0.99
    valid = found["valid"].values
    error = (found["range"] - capture["truth_range"]).values[valid]
    step_m = C_M_PER_S / 2 * float(np.diff(capture["delay"].values).mean())
    # Linear interpolation of the sum errs by about (step/σ_R)²/8, one per cent of a step; the median of small counts
    # lies up to a third of a count off their mean, which pulls by as much again. sigma is a rule of thumb.
    assert abs(error.mean()) < 0.05 * step_m
    z = error / found["sigma"].values[valid]
    assert 1 / 1.5 < z.std() < 1.5
    broken = [law for law in check_laws(module.half_sum, "gated") if not law.holds]
    assert not broken, broken
