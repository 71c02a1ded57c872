"""The package that `estimators new --stage line` writes reads a clean capture."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np

import beambench
from beambench.benchmarks.laws.laser_line import clean_capture
from beambench.captures.hide import hide_truth
from beambench.estimators import run_estimator


def test_the_written_finder_reads_a_line(tmp_path: Path) -> None:
    """Within .15 px rms of a line of .75 px (a centre of mass of 7 pixels), and a sigma that holds it."""
    folder = beambench.estimators_new("my-line", stage="line", out=tmp_path / "my-line")
    spec = importlib.util.spec_from_file_location("beambench_my_line", folder / "beambench_my_line.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    capture = clean_capture()
    found = run_estimator(module.my_line, hide_truth(capture))
    error = (found["column"] - capture["truth_column"]).values
    assert found["valid"].values.all() and np.sqrt((error**2).mean()) < 0.15
    assert np.sqrt(((error / found["sigma"].values) ** 2).mean()) < 1.2
