"""`beambench reproduce`: the rules of the verdicts, the models behind them, the table and its files."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import beambench
from beambench import cli
from beambench.benchmarks.reproduce import (
    accuracy,
    combined,
    deviation,
    objects,
    pixel_patch,
    ranger,
    reflection,
    roughness,
    stacks,
    table_1,
    tank,
    triangular,
)
from beambench.benchmarks.reproduce.illumination import depth_error
from beambench.benchmarks.reproduce.ladar import ladar_rows, summed_over_eq19
from beambench.benchmarks.reproduce.model import figure_9_points
from beambench.benchmarks.reproduce.rows import COLUMNS, VERDICTS, Row, judge_band, judge_exact, weakest
from beambench.benchmarks.reproduce.run import ITEMS, OTHERS, WITHOUT_ROWS, all_rows, to_csv
from beambench.benchmarks.reproduce.surfaces import figure_2_rows, peak_angle
from beambench.benchmarks.reproduce.tank_sets import SETS
from beambench.optics.constants import C_M_PER_S
from beambench.optics.reflection.chua import chua_printed
from beambench.scenes.errors import InputError

NAN = math.nan


def row(**changes: Any) -> Row:
    plain: dict[str, Any] = {"item": "Eq. 1", "quantity": "q", "unit": "1", "published": 1.0, "reproduced": 1.0,
                             "tolerance": 0.1, "verdict": "arithmetic", "note": ""}  # fmt: skip
    return Row(**(plain | changes))


# --- verdicts -----------------------------------------------------------------------------------------------------


def test_exact_verdicts() -> None:
    assert judge_exact(8.894, 8.8939, 5e-4) == "arithmetic"
    assert judge_exact(8.894, 5.618, 5e-4) == "contradicted"
    assert judge_exact(1.0, NAN, 0.1) == "contradicted"


def test_a_band_predicts_only_where_it_could_have_failed() -> None:
    assert judge_band(14.1, 14.2, 15.2, 2.2) == "predicted"
    assert judge_band(14.1, 7.0, 27.0, 2.2) == "undetermined"
    assert judge_band(2.3, 9.5, 29.5, 1.9) == "contradicted"
    assert judge_band(2.3, 0.0, 0.3, 1.9) == "contradicted"
    assert judge_band(10.0, 12.0, 12.0, 2.0) == "predicted"  # the tolerance's edge belongs to it
    for low, high in ((2.0, 1.0), (NAN, 1.0), (0.0, math.inf)):
        with pytest.raises(ValueError, match="finite"):
            judge_band(1.0, low, high, 0.1)


def test_a_prediction_that_any_guess_makes_too_has_no_power() -> None:
    assert judge_band(14.1, 14.2, 15.2, 2.2, [20.0, 8.0]) == "predicted"
    assert judge_band(14.1, 14.2, 15.2, 2.2, [20.0, 12.7]) == "undetermined"
    assert judge_band(14.1, 24.0, 25.0, 2.2, [12.7]) == "contradicted"


def test_an_item_claims_no_more_than_its_weakest_row() -> None:
    assert weakest(["trend", "undetermined", "contradicted"]) == "undetermined"
    assert weakest(["arithmetic", "fitted"]) == "fitted"
    assert weakest(iter(["arithmetic"])) == "arithmetic"
    with pytest.raises(ValueError, match="no verdict"):
        weakest([])


def test_rows_are_checked() -> None:
    with pytest.raises(ValueError, match="verdict"):
        row(verdict="plausible")
    with pytest.raises(ValueError, match="free"):
        row(verdict="fitted")
    assert row(verdict="fitted", free_parameters="x").document == "000"


def test_csv_of_rows() -> None:
    text = to_csv([row(published=NAN, note='a, "b"', reproduced=1.23456789, verdict="undetermined")])
    head, line = list(csv.reader(text.splitlines()))
    assert head == [
        "document", "item", "quantity", "unit", "published", "reproduced", "tolerance", "verdict", "free_parameters", "note",
    ]  # fmt: skip
    assert line == ["000", "Eq. 1", "q", "1", "", "1.23457", "0.1", "undetermined", "", 'a, "b"']
    assert text.endswith("\n") and "\r" not in text


# --- arithmetic ---------------------------------------------------------------------------------------------------


def test_printed_numbers_that_follow_by_arithmetic() -> None:
    rows = {(r.item, r.quantity): r for r in [*accuracy.accuracy_rows(), *ladar_rows()]}
    for number, published in ((1, 1.85), (2, 2.22)):
        found = rows["Eq. 25", f"depth error of Object {number} per set-up"]
        assert (found.published, found.verdict) == (published, "arithmetic")
    assert (
        rows["Eq. 22", "exponent of the signal-to-noise ratio against range, Eq. 15 with Eq. 22"].verdict
        == "arithmetic"
    )
    wrong = {item for (item, _), r in rows.items() if r.verdict == "contradicted"}
    assert wrong == {"Eq. 5", "Eq. 16"}
    # Eq. 5 over Eq. 6 is √σ_p, here of .5 ns in seconds.
    five = rows["Eq. 5", "Eq. 6 over Eq. 3 with Eq. 4 and Eq. 5, all as printed"]
    assert five.reproduced == pytest.approx(0.5e-9**-0.5, rel=1e-9)


def test_eq_16_against_closed_forms() -> None:
    """A short gate leaves the Gaussian pulse, whose sum is √(2π) σ of its peak; a long one a rectangle of width √12 σ."""
    assert accuracy.snr_over_eq16(0.01) == pytest.approx((2.0 * math.pi) ** 0.25, rel=1e-3)
    assert accuracy.snr_over_eq16(300.0) == pytest.approx(12.0**0.25, rel=1e-3)


def test_a_depth_needs_a_factor_between_one_and_root_two() -> None:
    """40,000 differences of a pixel and a mean of N: standard error of a standard deviation .35 %, tolerance 4 of them."""
    rng = np.random.default_rng(25)
    for pixels in (1, 4, 100):
        apart = rng.standard_normal(40_000) - rng.standard_normal((pixels, 40_000)).mean(axis=0)
        assert np.std(apart) == pytest.approx(accuracy.depth_over_range(pixels), rel=0.014)
    found = [r for r in accuracy.accuracy_rows() if r.quantity.startswith("accuracy of a depth")]
    assert [r.verdict for r in found] == ["undetermined"] and math.isnan(found[0].published)


def test_eq_19_needs_a_step_that_eq_18_itself_bounds() -> None:
    """Gates that tile the time pass all of the pulse, whatever its place; with gaps between them the place matters.

    Summed here over a pulse of 40,001 samples and a gate written out; a step of 1.7 gates leaves gaps of .7. Tolerance: one
    sample at each of two edges, 2 × 1.7 × 1.5e-13 s × the pulse's peak of 8e8/s, twice.
    """
    sigma, gate = 0.5e-9, 2.0e-9
    t = np.linspace(-6.0 * sigma, 6.0 * sigma, 40_001)
    power = np.exp(-0.5 * (t / sigma) ** 2)
    power /= power.sum()
    for step in (0.125, 1.7):
        for place in (0.0, 0.5):
            delay = (np.arange(-60, 61) + place) * step * gate
            open_ = (t[None] >= delay[:, None]) & (t[None] <= delay[:, None] + gate)
            summed = float((open_ @ power).sum()) * step
            assert summed_over_eq19(step * gate, place) == pytest.approx(summed, abs=1e-3)


def test_what_8_894_mm_implies() -> None:
    assert accuracy.implied(8.894e-3, 3e8) * 256 == pytest.approx(accuracy.SIGMA_TIMES_STEP_S2, rel=3e-5, abs=0)
    # The exact speed of light would have been printed as 8.888.
    assert accuracy.implied(8.894e-3, C_M_PER_S) * 256 != pytest.approx(accuracy.SIGMA_TIMES_STEP_S2, rel=1e-3, abs=0)
    # Two-digit mantissas are 90 in a decade, each met within ± 1.12e-4/ln 10, for up to 6 maxima and 2 speeds of light;
    # 255 and 256 and so on seldom coincide, so nearly 12 × 90 × 2 × 4.9e-5 = .105, a little less by overlaps.
    assert 0.06 < accuracy.chance_of_round_numbers() < 0.11


# --- models -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [0.2, 0.57, 0.6, 0.9, 2.0])
def test_where_the_specular_term_is_greatest(slope: float) -> None:
    """A grid of 1e-4 rad finds the same maximum; next to the normal the term is flat, hence the tolerance there."""
    theta = np.arange(0.0, 1.57, 1e-4)
    value = chua_printed(np.cos(theta), k_s=1.0, k_d=0.0, slope=slope, diffusivity=1.0)
    assert theta[np.argmax(value)] == pytest.approx(peak_angle(slope), abs=1e-4)
    assert [r.verdict for r in figure_2_rows()] == ["undetermined"]


def test_eq_12_errs_by_the_cube_of_its_angle() -> None:
    """θ_true − θ_12 = φ³(x − x³)/3 to third order, the relative error of depth θ times that: φ⁴ max (x² − x⁴)/3 = φ⁴/12."""
    for angle in (0.01, 0.1):
        assert depth_error(angle) == pytest.approx(angle**4 / 12.0, rel=0.02)


def rig(**changes: float) -> stacks.Rig:
    plain = {"sigma_s": 1.5e-9, "step_s": 0.3e-9, "background_m": 6.0, "near_sigmas": 6.0, "far_sigmas": 6.0, "wall": 1.0,
             "weaker": 0.5}  # fmt: skip
    return stacks.Rig(**(plain | changes))


def test_an_offset_compresses_depth_by_its_share() -> None:
    """Equal signals, all of R inside the delays (6 σ): KB/(S + KB), whatever the window."""
    for changes in ({}, {"near_sigmas": 9.0}, {"background_m": 20.0}):
        mine = rig(**changes)
        offset = stacks.fitted_offset(mine, 0.48, 0.1265, 0.48)
        r, echo = stacks.slices(mine, mine.background_m - 0.2, 1.0, 0.48)
        assert r.size * offset / echo.sum() == pytest.approx(table_1.offset_share(0.1265), rel=1e-4)
        found = stacks.depth(mine, 0.40, 1.0, offset, 0.48)
        assert found / 0.40 == pytest.approx(1.0 - 0.1265, rel=1e-4)
    assert table_1.offset_share(0.1265) == pytest.approx(0.1448, abs=5e-5)
    assert table_1.offset_share(0.1411) == pytest.approx(0.1643, abs=5e-5)


def test_cubic_weights_move_an_echo_by_twice_its_variance_over_range() -> None:
    mine = rig()
    r, echo = stacks.slices(mine, 5.5, 1.0, 0.48)
    variance = (0.5 * C_M_PER_S * mine.sigma_s) ** 2
    # ⟨r³⟩/⟨r²⟩ of a Gaussian is r(r² + 3σ²)/(r² + σ²).
    exact = 5.5 * (5.5**2 + 3 * variance) / (5.5**2 + variance)
    assert stacks.cubic_average(r, echo) == pytest.approx(exact, rel=1e-7)
    assert stacks.cubic_average(r, echo) - 5.5 == pytest.approx(2 * variance / 5.5, rel=0.01)
    assert stacks.weighted_average(r, echo) == pytest.approx(5.5, rel=1e-8)
    # A threshold keeps the top of a symmetric echo.
    assert stacks.weighted_average(r, echo + 0.01, 0.1) == pytest.approx(5.5, abs=2e-3)


def test_no_offset_fits_what_cannot_be_had() -> None:
    assert math.isnan(stacks.fitted_offset(rig(), 0.48, 5.0, 0.48))


def test_radial_taken_for_depth() -> None:
    angle = table_1.radial_angle(5.0, 0.0, 0.48, 0.0607)
    assert 5.0 * (1.0 / math.cos(angle) - 1.0) == pytest.approx(0.0607, rel=1e-9)


def test_table_1_is_told_as_it_is() -> None:
    rows = table_1.table_1_rows()
    verdict = {
        (r.quantity.split(",")[0], r.quantity.split(", ", 1)[1]): r.verdict for r in rows if r.quantity[:6] == "Object"
    }
    for number in (1, 2):
        assert verdict[f"Object {number}", "proposed without its cosine (r³/r²), reading «offset»"] == "contradicted"
        assert verdict[f"Object {number}", "proposed as printed (÷ cos, r³/r²), reading «radial»"] == "contradicted"
    # Where the same length (15.18 %) and the same percentage (12.65 %) as for Object 1 agree too, nothing is predicted.
    for reading in ("offset", "radial", "both", "same length"):
        assert verdict["Object 2", f"weighted average, reading «{reading}»"] == "undetermined"
    assert table_1.guesses("weighted average") == pytest.approx({"same percentage": 12.65, "same length": 15.18})
    assert table_1.guesses("proposed") == pytest.approx({"same percentage": 2.26, "same length": 2.712})
    for column, off in (("weighted average", 1.07), ("proposed", 0.22)):
        length = table_1.guesses(column)["same length"]
        assert abs(length - table_1.PUBLISHED[column][1]) == pytest.approx(off, abs=5e-3)
    assert "predicted" not in verdict.values() and "fitted" not in verdict.values()
    bands = table_1.bands()
    assert bands["weighted average", 1] == pytest.approx((12.65,) * 3, abs=1e-6)
    assert bands["r³/r²", 1][0] > 12.65  # cubic weights make it worse in the median
    assert bands["weighted average over 10 %", 1][0] < 2.26
    assert all(low <= middle <= high for middle, low, high in bands.values())


def test_figures_3_4_and_7_show_their_trends() -> None:
    rows = [*reflection.reflection_rows(), *deviation.deviation_rows(), *ranger.ranger_rows()]
    assert {r.item for r in rows} == {"Figure 3", "Figure 4", "Figure 7"}
    assert "contradicted" not in {r.verdict for r in rows}
    # Weak over strong and the rise with the angle by two instruments; proportion to reflectivity; Figure 4's order; and
    # the noise of a whole record.
    assert sum(r.verdict == "trend" for r in rows) == 2 + 2 + 1 + 1 + 1


# --- Wang et al. 2013 -----------------------------------------------------------------------------------------------


def test_triangular_against_trapezoidal_profiles() -> None:
    # The formula at its two ends, and the fluctuation that gives the published 2.5 in between.
    assert triangular.precision_ratio(1e3, 0.0) == pytest.approx(np.sqrt(5.0))
    assert triangular.precision_ratio(1e3, 1e3) == pytest.approx(np.sqrt(10.0), rel=1e-3)
    needed = triangular.fluctuation_for(2.5, 1e3)
    assert triangular.precision_ratio(1e3, needed) == pytest.approx(2.5)
    assert 2 * needed**2 * 1e3 == pytest.approx(5 / 3)
    for ratio in (2.2, 3.2):
        with pytest.raises(ValueError, match="between"):
            triangular.fluctuation_for(ratio, 1e3)
    # The estimator follows it: 9,600 pairs each, the ratio of two rms errors has a standard error of 1 %; 4 of them.
    for fluctuation in (0.0, 0.03):
        law = triangular.precision_ratio(3000.0, fluctuation, 0.1, 0.9)
        assert triangular.measured_ratio(fluctuation) == pytest.approx(law, rel=0.04)


# --- the whole ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return beambench.reproduce(out=tmp_path_factory.mktemp("reproduce") / "out")


def test_the_table_has_every_item_and_its_verdict(done: Any, project: Path) -> None:
    with (project / "docs" / "coverage.csv").open(newline="", encoding="utf-8") as file:
        covered = {r["item"]: r["verdict"] for r in csv.DictReader(file) if r["document"] == "000"}
    with (project / "docs" / "coverage.csv").open(newline="", encoding="utf-8") as file:
        other = {r["item"]: r["verdict"] for r in csv.DictReader(file) if r["document"] == "001"}
    for item in (*pixel_patch.ITEMS, *tank.ITEMS, *roughness.ITEMS):
        assert other[item] == weakest(r.verdict for r in done.rows if r.item == item), item
    wanted = [f"Eq. {n}" for n in range(1, 35)] + [f"Figure {n}" for n in range(1, 17)] + ["Table 1"]
    wanted += ["Flow runs", "Phase in radians", "Peak-to-valley"]
    wanted = [item for item in wanted if covered[item] != "nothing-to-compute"]
    assert sorted(wanted) == sorted(ITEMS)
    by_item: dict[str, list[Any]] = {item: [] for item in (*ITEMS, *OTHERS)}
    for r in done.rows:
        by_item[r.item].append(r.verdict)
    assert {item for item, verdicts in by_item.items() if not verdicts} == set(WITHOUT_ROWS)
    # What coverage.csv says of an item is the weakest verdict of its rows; without rows it claims no comparison.
    for item in wanted:
        if by_item[item]:
            allowed = {weakest(by_item[item])}
            if allowed == {"arithmetic"}:
                allowed.add("implemented")
            assert covered[item] in allowed, item
        else:
            assert covered[item] in ("implemented", "by-construction"), item
    assert len({(r.item, r.quantity) for r in done.rows}) == len(done.rows)
    order = [(*ITEMS, *OTHERS).index(r.item) for r in done.rows]
    assert order == sorted(order)


def test_the_files(done: Any) -> None:
    table = pd.read_csv(done.out / "reproduction.csv", dtype={"document": str})
    assert tuple(table.columns) == COLUMNS
    assert set(table["verdict"]) == set(VERDICTS) - {"predicted", "by-construction"}  # no row claims these two
    assert table["document"].isin(["000", "001"]).all()
    others = {triangular.ITEM, *pixel_patch.ITEMS, *tank.ITEMS, *roughness.ITEMS}
    assert set(table["item"][~table["item"].isin(ITEMS)]) == others == set(OTHERS)
    assert table["reproduced"].notna().all()
    assert set(table["published"].dropna()) == {
        8.894,
        1.85,
        2.22,
        14.11,
        2.26,
        2.93,
        -1.0,
        2.5,
        5.0,
        81.5,
        2.0,
        4.0,
        *(r for data_set in SETS for r in (data_set.target_range_m, data_set.corner_range_m)),
        50.0,
        157.0,
        210.0,
        0.002657,
        0.1522,
        0.011194,
        0.6414,
    }  # as printed, and no others
    parquet = pd.read_parquet(done.out / "reproduction.parquet")
    assert list(parquet.columns) == list(COLUMNS) and len(parquet) == len(table)
    np.testing.assert_allclose(parquet["reproduced"], table["reproduced"], rtol=1e-5)
    page = done.page.read_text(encoding="utf-8")
    assert page.count("<section") == len(ITEMS) + len(OTHERS) and "http://" not in page and "https://" not in page
    assert page.count("<img") == len(list((done.out / "pictures").glob("*.png"))) == 6 + 2 * 5 + 4
    for picture in (done.out / "pictures").glob("*.png"):
        assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and picture.stat().st_size > 1000
    assert json.loads((done.out / "run.json").read_text(encoding="utf-8"))["rows"] == len(table)


def test_equal_bytes_and_known_numbers(done: Any) -> None:
    """Everything anew: the csv is the same to the byte, and the captures show what Eq. 24 does."""
    for cached in (objects.objects, table_1._offset_errors, table_1._radial_errors, table_1._combined, combined.fits):
        cached.cache_clear()
    assert to_csv(all_rows()) == (done.out / "reproduction.csv").read_text(encoding="utf-8")
    rows = {(r.item, r.quantity): r for r in done.rows}
    cancel = rows["Eq. 23", "change of range when another reflection (Eq. 4) is put in, relative"]
    assert cancel.verdict == "contradicted" and cancel.reproduced < 1e-12
    assert rows["Eq. 24", "mean error of the background's range as printed, ÷ cosθ"].reproduced > 80.0
    points = {(p["object"], p["method"], p["capture"]): p["error"] for p in figure_9_points()}
    # Noise of some 500 pixels a side: .4 mm/√500 of 480 mm; what is left is clipping of none and the bisection of all.
    assert points["Object 1", "weighted average", "with offset"] == pytest.approx(-12.65, abs=0.05)
    assert abs(points["Object 1", "weighted average", "clean"]) < 0.2
    assert points["Object 1", "proposed as printed, taken as depth", "clean"] > 20.0


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", "--help"]) == 0
    shown = capsys.readouterr().out
    assert "Example" in shown and "beambench reproduce" in shown
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match="exists"):
        beambench.reproduce(out=tmp_path / "mine")
    assert cli.main(["reproduce", "-o", str(tmp_path / "mine"), "--overwrite"]) == 2
    assert (tmp_path / "mine" / "thesis.tex").exists()
