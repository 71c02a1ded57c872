"""The scripts of docs/wavefront.md, on tables of a few rows, and the smaller checks of wavefronts."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.checks import centroids as finest
from beambench.benchmarks.checks import turbulence_tasks as tasks

DOCS = Path(__file__).resolve().parents[1] / "docs"


def script(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A script of the folder docs as a module."""
    if not (DOCS / f"{name}.py").is_file():
        pytest.skip("the folder docs is not beside the tests")
    monkeypatch.syspath_prepend(str(DOCS))
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, f"docs_{name}", module)
    spec.loader.exec_module(module)
    return module


def test_a_breakdown_says_what_was_not_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    page = script("wavefront", monkeypatch)
    rows = {
        "suite": "stress-wavefront-flux", "axis": "photons", "unit": ["1"] * 3, "estimator": ["a", "b", "c"],
        "level10": [12.34, np.nan, np.nan], "lo": [np.nan, np.nan, np.nan], "hi": [13.0, np.nan, np.nan],
        "mode": ["outlier", "none", "refusal"],
    }  # fmt: skip
    pd.DataFrame(rows).to_csv(tmp_path / "breakdown.csv", index=False)
    text = page.breakdown([tmp_path])
    assert text.splitlines()[0] == "| axis | `a` | `b` | `c` |"
    assert text.splitlines()[2] == "| `flux`: photons | 12.3 […, 13] outlier | never | ? (refusal) |"
    with pytest.raises(SystemExit, match="no sweep"):
        page.main(tmp_path / "none")


def test_one_row_is_written_and_the_others_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    page, text = script("wavefront", monkeypatch), tmp_path / "page.md"
    head = "| axis | `a` |\n|---|---|\n"
    text.write_text(
        f"<!-- table:breakdown -->\n{head}| `flux`: photons | 1 |\n| `slope`: rad | 2 |\n<!-- end:breakdown -->\n"
    )
    rows = page.added(f"{head}| `pixels`: m | 3 |\n| `slope`: rad | 4 |", text).splitlines()[2:]
    assert rows == ["| `flux`: photons | 1 |", "| `pixels`: m | 3 |", "| `slope`: rad | 4 |"]
    with pytest.raises(SystemExit, match="other estimators"):
        page.added("| axis | `b` |\n|---|---|\n| `pixels`: m | 3 |", text)


def summary() -> pd.DataFrame:
    """Two centroids at two levels of light, and a chain."""
    rows = []
    for name, error in (("worse", 0.2), ("better", 0.1)):
        for level in (1.0, 0.1):
            rows.append(("spot", "matched", level, name, error / level, 0.05 / level, 1.5, 8e-3))
        rows.append(("spot", "calibrated", 1.0, name, 9.0, 9.0, 9.0, 9.0))
    rows += [(name, "matched", 1.0, "chain", 0.3, 0.2, 2.0, 1e-2) for name in ("zernike", "phase")]
    return pd.DataFrame(
        rows, columns=["quantity", "condition", "level", "estimator", "rmse", "bound", "z_rms", "cpu_s"]
    )


def test_tables_of_a_run_are_sorted_by_error(monkeypatch: pytest.MonkeyPatch) -> None:
    page = script("wavefront", monkeypatch)
    lines = page.centroids(summary(), {1.0: "3,000", 0.1: "300"}).splitlines()
    assert lines[0] == "| centroid | 3,000 e⁻ | 300 e⁻ | z | CPU, ms |"
    assert lines[2:] == [
        "| `better` | 0.1 | 1 | 1.50 | 2 |",
        "| `worse` | 0.2 | 2 | 1.50 | 2 |",
        "| bound | 0.05 | 0.5 | | |",
    ]
    assert page.chains(summary()).splitlines()[2] == "| `chain` | 0.3 | 2.00 | 0.3 | 2.00 |"


def test_the_page_has_a_place_for_every_table(monkeypatch: pytest.MonkeyPatch) -> None:
    page = script("wavefront", monkeypatch)
    text = (DOCS / "wavefront.md").read_text(encoding="utf-8")
    for name in ("breakdown", "centroids", "chains"):
        assert text.count(f"<!-- table:{name} -->") == text.count(f"<!-- end:{name} -->") == 1
    for name in page.ELECTRONS.values():
        assert f"{name} e⁻" in text


def test_pictures_show_what_was_captured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three surfaces, and a circle for each lenslet in view."""
    pytest.importorskip("vl_convert")
    from beambench.generator.generate import generate
    from beambench.scenes.load import load_scene

    page = script("wavefront_pictures", monkeypatch)
    capture = generate(
        load_scene("turbulent-tank", {"rig.frames.count": 1, "rig.imager": None, "rig.propagation": "phase-screens"}),
        seed=1,
        fidelity="geometric",
    )
    assert page.surfaces(capture).count("rad") >= 2
    field = page.spot_field(capture)
    assert 49 <= field.count("<circle") <= 81 and field.count("<line") == field.count("<circle")


def test_the_area_of_a_perfect_separation_is_no_surer_than_its_numbers() -> None:
    rng = np.random.default_rng(1)
    assert tasks.area(np.array([2.0, 3.0]), np.array([0.0, 1.0]), rng) == pytest.approx((1.0, 0.025**0.5, 1.0))
    equal, low, high = tasks.area(np.ones(4), np.ones(4), rng)
    assert equal == 0.5 and low <= 0.5 <= high


def test_a_share_has_the_exact_interval() -> None:
    """Clopper and Pearson: 24 of 24 leaves .025^{1/24} open; 0 of 24 the complement."""
    assert tasks.share(24, 24) == pytest.approx((1.0, 0.025 ** (1 / 24), 1.0))
    assert tasks.share(0, 24) == pytest.approx((0.0, 0.0, 1.0 - 0.025 ** (1 / 24)))


def test_registration_takes_a_shift_back_and_no_blur() -> None:
    """A shift by eighths of a pixel, which is on the grid of sixteenths; what remains is the blur's own error."""
    from scipy.ndimage import fourier_shift, gaussian_filter

    true = gaussian_filter(np.random.default_rng(2).random((48, 48)), 2.0, mode="wrap")
    moved = np.fft.ifftn(fourier_shift(np.fft.fftn(true), (1.125, -2.375))).real
    assert tasks.psnr(moved, true) < 60.0 < 120.0 < tasks.psnr(tasks.registered(moved, true), true)
    blurred = gaussian_filter(moved, 1.5, mode="wrap")
    only = tasks.psnr(gaussian_filter(true, 1.5, mode="wrap"), true)
    assert tasks.psnr(tasks.registered(blurred, true), true) == pytest.approx(only, abs=0.05)


def test_a_layer_takes_the_place_of_the_flow() -> None:
    assert tasks.tank(20.0).rig.turbulence.flow_l_per_min == 20.0  # type: ignore[union-attr]
    (layer,) = tasks.layer_at(1.5).rig.turbulence.layers  # type: ignore[union-attr]
    assert layer.range_m == 1.5 and layer.r0_m == tasks.LAYER_R0_M


def test_a_cell_of_the_table_of_centroids() -> None:
    """Two centroids on one cell: spot-ml within 10 % of the bound, the centre of gravity above it."""
    cell = finest.Cell(1.33, 3.0, 3000.0)
    best, plain = finest.rows_of(cell, ("spot-ml", "spot-centroid"))
    assert (
        best["estimator"] == "spot-ml"
        and 0.9 < best["ratio"] < 1.1
        and best["ratio_lo"] < best["ratio"] < best["ratio_hi"]
    )
    assert plain["ratio"] > best["ratio"] and best["lost"] == plain["lost"] == 0.0
