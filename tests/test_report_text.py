"""The summary of a run in words, and its numbers and pictures."""

from __future__ import annotations

import importlib.util
import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.report.cell import common_noun
from beambench.benchmarks.report.data import base_cells, by_quantity, cells_of
from beambench.benchmarks.report.front import mark_front
from beambench.benchmarks.report.layout import log_domain, log_ticks, place_labels
from beambench.benchmarks.report.numbers import number, rate, time_text
from beambench.benchmarks.report.pictures import DIVERGING, SEQUENTIAL, Picture, error_limit, lut, png, value_limits
from beambench.benchmarks.report.text import closing_lines, rank, summary
from beambench.benchmarks.scores.tables import read_scores
from beambench.captures.layouts import LAYOUTS, layout_of

from . import _api_fixtures as made_up


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    folder = made_up.make_run(tmp_path_factory.mktemp("run"), stress=True, pictures=False)
    scores = read_scores(folder)
    assert len(scores) == 3 * 2 * 2 * 6 + 12
    return scores


def test_closing_lines(table: pd.DataFrame) -> None:
    best, fastest, *rest = closing_lines(table)
    assert best.startswith("best     poisson-ml")
    assert fastest.startswith("fastest  peak: 4.00 ns")
    fails = {line.split()[1].rstrip(":"): line for line in rest}
    assert set(fails) == {"peak", "weighted-average", "parabola", "chua-2017"}
    assert "step, matched (crash)" in fails["parabola"]
    assert "tank-relief, matched (22.0 % of pixels)" in fails["chua-2017"]


def test_closing_lines_without_failures_and_without_results() -> None:
    good = pd.DataFrame([made_up.score_row()])
    assert closing_lines(good)[-1].startswith("fails    none")
    bad = pd.DataFrame([made_up.score_row(status="timeout: call over 3 s", rmse_full=np.nan)])
    first, second = closing_lines(bad)
    assert "none" in first and "(timeout)" in second


def test_three_sentences(table: pd.DataFrame) -> None:
    sentences = summary(table)
    assert len(sentences) == 3 and all(sentence.endswith(".") for sentence in sentences)
    assert "4 estimators fail" in sentences[2]


def test_a_result_better_than_its_bound_is_told_in_the_last_lines_and_on_the_page(tmp_path: Path) -> None:
    """From 1.2 times the bound's information on, over at least 100 elements; never of fewer, and never silently."""
    from beambench.benchmarks.report.page import write_report

    fair, doubtful = (
        made_up.score_row(scene="a", efficiency=1.15),
        made_up.score_row(scene="b", efficiency=5000.0, n=100),
    )
    few = made_up.score_row(scene="c", efficiency=5000.0, n=99)
    assert not [line for line in closing_lines(pd.DataFrame([fair, few])) if line.startswith("doubt")]
    (told,) = [line for line in closing_lines(pd.DataFrame([fair, doubtful, few])) if line.startswith("doubt")]
    assert "efficiency of 5e+03 in b" in told and "100 pixels" in told
    pd.DataFrame([fair, doubtful, few]).to_csv(tmp_path / "scores.csv", index=False)
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert page.count('<p class="doubt" role="alert">') == 1 and "5e+03 in b" in page


def _suite(scenes: int, spread: float, lead: float) -> pd.DataFrame:
    """a ahead of b and c by a factor, on scenes whose ratios scatter; one seed."""
    rng = np.random.default_rng(3)
    factors = {"a": 1.0, "b": lead, "c": 2.0 * lead}
    return pd.DataFrame(
        made_up.score_row(scene=f"s{k}", estimator=name, rmse_full=1e-3 * factor * np.exp(spread * rng.normal()))
        for k in range(scenes)
        for name, factor in factors.items()
    )


def test_the_most_accurate_is_called_so_only_where_scenes_tell() -> None:
    """As the ranking of the same page has it: paired over scenes, corrected for all pairs, six scenes at least."""
    assert "a is the most accurate" in summary(_suite(12, 0.05, 1.5))[0]
    assert "2 of 2 others significantly worse" in closing_lines(_suite(12, 0.05, 1.5))[0]
    for table, worse in ((_suite(12, 0.0, 1.0001), 2), (_suite(12, 0.3, 1.0001), 1), (_suite(3, 0.05, 1.5), 0)):
        first = summary(table)[0]
        # Without any scatter even a hair is certain; with scatter, or on few scenes, it is not.
        assert ("is the most accurate" in first) == (worse == 2)
        assert worse == 2 or "has the smallest error" in first
        assert f"{worse} of 2 others significantly worse" in closing_lines(table)[0]
    alone = summary(pd.DataFrame([made_up.score_row()]))[0]
    assert "has the smallest error" in alone and "others" not in alone


def test_a_ratio_to_the_bound_is_of_one_condition_and_of_exact_bounds() -> None:
    rows = [
        made_up.score_row(scene="x", rmse_full=1e-3, bound=5e-4),
        made_up.score_row(scene="y", rmse_full=1e-3, bound=1e-5, bound_kind="bayes"),
        made_up.score_row(scene="x", condition="calibrated", rmse_full=9e-3, bound=5e-4),
        made_up.score_row(scene="y", condition="calibrated", rmse_full=9e-3, bound=5e-4),
    ]
    table = pd.DataFrame(rows)
    assert "(matched), peak has the smallest error" in summary(table)[0]
    assert "2.00 times the exact bound" in summary(table)[0] and "(matched)" in closing_lines(table)[0]


def test_an_estimator_without_any_error_is_ranked_first() -> None:
    rows = [
        made_up.score_row(scene=scene, estimator=name, rmse_full=error)
        for scene, errors in {"x": (0.0, 1e-3, 0.0), "y": (1e-3, 2e-3, 2e-3)}.items()
        for name, error in zip("abc", errors, strict=True)
    ]
    ranked = rank(cells_of(pd.DataFrame(rows)))
    assert [r.label for r in ranked] == ["a", "c", "b"] and all(r.cells == 2 for r in ranked)
    assert ranked[0].error_ratio == 1.0 and ranked[1].error_ratio == pytest.approx(2**0.5)
    assert ranked[0].bound_ratio == 0.0 and np.isinf(ranked[2].error_ratio)
    assert "a has the smallest error" in summary(pd.DataFrame(rows))[0]


def test_what_is_of_answered_elements_is_weighted_by_these() -> None:
    few: dict[str, Any] = {"n": 1000, "coverage": 0.1, "bias": 1e-2, "p95": 1e-1, "rmse": 2e-2, "bound_kind": "bayes"}
    most: dict[str, Any] = {"n": 1000, "coverage": 0.9, "bias": 0.0, "p95": 1e-3, "rmse": 1e-3}
    (cell,) = cells_of(pd.DataFrame([made_up.score_row(seed=1, **most), made_up.score_row(seed=2, **few)]))
    assert cell.bias == pytest.approx(1e-3) and cell.p95 == pytest.approx(0.1 * 1e-1 + 0.9 * 1e-3)
    assert cell.rmse == pytest.approx((0.1 * 4e-4 + 0.9 * 1e-6) ** 0.5)
    assert cell.bound_kind == "bayes", "the weakest of the seeds', as in summary.csv"


def test_a_bias_that_seeds_show_together_blanks_the_pooled_efficiency() -> None:
    rows = [made_up.score_row(seed=seed, n=30, bias=4e-4, rmse=1e-3) for seed in range(10)]
    assert cells_of(pd.DataFrame(rows))[0].efficiency != cells_of(pd.DataFrame(rows))[0].efficiency
    assert cells_of(pd.DataFrame(rows[:1]))[0].efficiency == pytest.approx(0.36)


def test_the_table_of_the_readme_pools_all_scenes_or_none(tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "docs" / "pictures.py"
    spec = importlib.util.spec_from_file_location("readme_pictures", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    figures = {"all": (0.5, 0.25), "one": (0.5, np.nan)}
    rows = [
        made_up.score_row(estimator=name, scene=scene, efficiency=value)
        for name, values in figures.items()
        for scene, value in zip("xy", values, strict=True)
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "scores.csv", index=False)
    lines = {line.split("`")[1]: line for line in module.table(tmp_path).splitlines() if "`" in line}
    assert " | 0.33 | " in lines["all"], "1/efficiency is a mean square: 2 and 4 make 3"
    assert " | – | " in lines["one"]


def test_refusing_does_not_pay() -> None:
    """The ranking goes by the error over all elements, so answering a few easy ones does not win."""
    rows = [
        made_up.score_row(estimator="picky", coverage=0.3, rmse=1e-5, rmse_full=5e-2, bound=1e-5),
        made_up.score_row(estimator="plain", coverage=1.0, rmse=1e-3, rmse_full=1e-3),
    ]
    assert [r.label for r in rank(cells_of(pd.DataFrame(rows)))] == ["plain", "picky"]


def test_who_crashed_somewhere_comes_last() -> None:
    rows = [
        made_up.score_row(scene="a", estimator="brittle", rmse_full=1e-6),
        made_up.score_row(scene="b", estimator="brittle", status="crash", rmse_full=np.nan),
        made_up.score_row(scene="a", estimator="steady"),
        made_up.score_row(scene="b", estimator="steady"),
    ]
    assert [r.label for r in rank(cells_of(pd.DataFrame(rows)))] == ["steady", "brittle"]


def test_seeds_are_pooled_as_squares() -> None:
    rows = [made_up.score_row(seed=0, rmse_full=3e-3), made_up.score_row(seed=1, rmse_full=4e-3)]
    (cell,) = cells_of(pd.DataFrame(rows))
    assert cell.rmse_full == pytest.approx(np.sqrt((9e-6 + 16e-6) / 2), rel=1e-12)
    assert cell.seeds == 2


def test_cost_counts_every_element_that_was_read() -> None:
    """throughput × wall time is the number of elements read; n is only those with an unmixed truth."""
    (cell,) = cells_of(pd.DataFrame([made_up.score_row(n=10, cpu_s=2.0, wall_s=4.0, throughput=250.0)]))
    assert cell.cpu_per_element_s == pytest.approx(2e-3, rel=1e-12)


def test_pareto_front() -> None:
    points = {"a": (1.0, 9.0), "b": (2.0, 9.0), "c": (3.0, 1.0), "d": (4.0, 2.0)}
    rows = [
        made_up.score_row(estimator=name, cpu_s=cpu, wall_s=1.0, throughput=1.0, rmse_full=error)
        for name, (cpu, error) in points.items()
    ]
    cells = cells_of(pd.DataFrame(rows))
    mark_front(cells)
    assert {cell.label for cell in cells if cell.front} == {"a", "c"}


def test_stressed_and_mixed_cells_stand_apart() -> None:
    rows = [
        made_up.score_row(),
        made_up.score_row(stress="background", level="0.5"),
        made_up.score_row(quantity="range-mixed"),
    ]
    cells = cells_of(pd.DataFrame(rows))
    assert [cell.quantity for cell in base_cells(cells)] == ["range"]
    assert {cell.place for cell in cells} == {
        "flat-wall, matched", "flat-wall, matched, background 0.5", "flat-wall, matched, mixed pixels",
    }  # fmt: skip


def test_parquet_and_csv_read_the_same(tmp_path: Path, table: pd.DataFrame) -> None:
    table.to_parquet(tmp_path / "scores.parquet")
    pd.testing.assert_frame_equal(read_scores(tmp_path), table, check_column_type=False)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1.0, "1.00"), (0.012345, "0.0123"), (123456.0, "123456"), (1.5e9, "1.50e+09"), (float("nan"), "–")],
)
def test_numbers(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(1.0, "100 %"), (0.99999, "> 99.9 %"), (0.0, "0 %"), (1e-6, "< 0.1 %"), (0.5, "50.0 %")]
)
def test_rates_do_not_round_away_what_matters(value: float, text: str) -> None:
    assert rate(value) == text


def test_times() -> None:
    assert [time_text(value) for value in (2.5e-9, 3e-6, 0.5, 12.0)] == ["2.50 ns", "3.00 µs", "500 ms", "12.0 s"]


def _decode(image: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Palette indices (row, col) and palette (n, 3) of a PNG, with every checksum verified."""
    assert image.startswith(b"\x89PNG\r\n\x1a\n")
    chunks, at = {}, 8
    while at < len(image):
        (length,) = struct.unpack(">I", image[at : at + 4])
        kind, data = image[at + 4 : at + 8], image[at + 8 : at + 8 + length]
        assert struct.unpack(">I", image[at + 8 + length : at + 12 + length])[0] == zlib.crc32(kind + data)
        chunks[kind] = data
        at += 12 + length
    cols, rows = struct.unpack(">II", chunks[b"IHDR"][:8])
    raw = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(rows, cols + 1)
    assert not raw[:, 0].any()
    return raw[:, 1:], np.frombuffer(chunks[b"PLTE"], np.uint8).reshape(-1, 3)


def test_pictures_show_values_by_their_colours() -> None:
    values = np.array([[0.0, 1.0, 2.0], [-9.0, 9.0, np.nan]])
    answered = np.array([[True, True, True], [True, True, False]])
    index, palette = _decode(png(values, 0.0, 2.0, SEQUENTIAL, answered=answered))
    assert tuple(palette[index[0, 0]]) == (0x44, 0x01, 0x54) and tuple(palette[index[0, 2]]) == (0xFD, 0xE7, 0x25)
    assert index[1, 0] == index[0, 0] and index[1, 1] == index[0, 2], "values beyond the scale take its end colours"
    assert index[1, 2] == len(palette) - 1, "an answer that is due and missing has its own colour"
    assert _decode(png(values, 0.0, 2.0, SEQUENTIAL))[0][1, 2] == len(palette) - 2, "no truth is clear"


def test_pictures_agree_with_another_decoder(tmp_path: Path) -> None:
    """OpenImageIO, which shares no code with our writer, reads the same colours."""
    oiio = pytest.importorskip("OpenImageIO")
    values = np.linspace(-1, 1, 12 * 7).reshape(12, 7)
    image = png(values, -1.0, 1.0, DIVERGING)
    (tmp_path / "x.png").write_bytes(image)
    pixels = oiio.ImageBuf(str(tmp_path / "x.png")).get_pixels(oiio.UINT8)
    index, palette = _decode(image)
    assert np.array_equal(pixels[..., :3], palette[index])


def test_large_pictures_are_thinned() -> None:
    index, _ = _decode(png(np.zeros((1000, 640)), -1.0, 1.0, DIVERGING))
    assert max(index.shape) <= 320


def test_lightness_of_the_range_colours_rises() -> None:
    """Also in grey, as the colour-blind and a printer see it (Rec. 709 luma)."""
    luma = lut(SEQUENTIAL, 64) @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(luma) > 0)


def _picture(error: float) -> Picture:
    values = np.full((8, 8), error, np.float32)
    return Picture("s", "e", "", values, values, values, np.ones((8, 8), bool))


def test_one_bad_estimator_does_not_wash_out_the_rest() -> None:
    good = [_picture(1e-3) for _ in range(4)]
    assert error_limit(good) == pytest.approx(5e-3)
    assert error_limit([*good, _picture(1.0)]) == pytest.approx(5e-3)
    assert error_limit([_picture(0.0)]) > 0
    assert value_limits(np.full((4, 4), np.nan), 0.01) == (0.0, 1.0)
    assert value_limits(np.full((4, 4), 5.0), 0.01) == pytest.approx((4.995, 5.005))


def test_ticks_and_limits() -> None:
    lo, hi = log_domain([1.0, 30.0])
    assert lo < 1.0 and hi > 30.0
    assert log_ticks(lo, hi) == [1.0, 2.0, 5.0, 10.0, 20.0]
    assert log_ticks(0.9, 3000.0) == [1.0, 10.0, 100.0, 1000.0]
    lo, hi = log_domain([2.0, 2.0])
    assert hi / lo >= 10**0.5 * 0.99


def test_labels_do_not_overlap() -> None:
    """Eight names at nearly one place: every pair of label boxes is apart."""
    points = [
        {"cpu": 10 * 1.02**i, "error": 1.0 * 1.01**i, "front": i == 0, "text": f"name-{i}", "label": f"{i}"}
        for i in range(8)
    ]
    points.append({"cpu": 1000.0, "error": 100.0, "front": False, "text": "far", "label": "far"})
    place_labels(points, [point["cpu"] for point in points], [point["error"] for point in points])
    places = {(point["align"], point["dx"], point["dy"]) for point in points[:8]}
    assert len(places) >= 6


def test_an_estimator_is_labelled_once_unless_its_points_lie_apart() -> None:
    def points(second: float) -> list[dict[str, object]]:
        first = {"cpu": 10.0, "error": 1.0, "front": False, "text": "a", "label": "a"}
        return [first, first | {"error": second}, {"cpu": 1e3, "error": 1e3, "front": False, "text": "b", "label": "b"}]

    for second, shown in ((1.05, ["a", "", "b"]), (300.0, ["a", "a", "b"])):
        placed = points(second)
        place_labels(placed, [10.0, 1e3], [1.0, 1e3])
        assert [point["text"] for point in placed] == shown


def _chain_rows() -> pd.DataFrame:
    """A centroid, and a chain of two quantities: 608 spots, 80 coefficients and 20,000 samples of 4 frames in 8 ms."""
    kinds = (
        ("centroid", "spot", "px", 608, 0.0157, "spot-ml"),
        ("reconstruction", "zernike", "rad", 80, 0.0376, "spot-ml+slope-cell+zernike-ls"),
        ("reconstruction", "phase", "rad", 20000, 0.258, "spot-ml+slope-cell+zernike-ls"),
    )
    return pd.DataFrame([
        made_up.score_row(
            modality="wavefront", stage=stage, quantity=quantity, unit=unit, n=n, rmse_full=rmse, rmse=rmse, bound=rmse,
            estimator=estimator, cpu_s=8e-3, wall_s=8e-3, throughput=n / 8e-3,
        )
        for stage, quantity, unit, n, rmse, estimator in kinds
    ])  # fmt: skip


def test_times_are_counted_by_the_elements_of_the_quantity_and_named_so() -> None:
    cells = cells_of(_chain_rows())
    assert [(cell.noun, round(cell.cpu_per_element_s * 1e9)) for cell in cells] == [
        ("spot", 13158), ("coefficient", 100000), ("sample", 400),
    ]  # fmt: skip
    assert common_noun(cells) == "element" and common_noun(cells[:1]) == "spot"


def test_quantities_are_not_ranked_against_each_other() -> None:
    """Errors in px and rad, and times per spot and per coefficient, have no order."""
    table = _chain_rows()
    lines = closing_lines(table)
    assert [line.split(":")[0] for line in lines[:6]] == [
        f"{word:9}{name}" for name in ("spot", "zernike", "phase") for word in ("best", "fastest")
    ]
    assert "13.2 µs CPU per spot" in lines[0] and "100 µs CPU per coefficient" in lines[2]
    first, spot, zernike, phase, last = summary(table)
    assert first.endswith("by what is estimated:") and phase.startswith("phase: ") and "elements" in last
    assert spot.startswith("spot: spot-ml has the smallest error, down to 0.0157 px")
    assert zernike.startswith("zernike: spot-ml+slope-cell+zernike-ls has the smallest error, down to 0.0376 rad")
    assert "100 µs of CPU time per coefficient" in zernike


def test_every_quantity_of_more_elements_than_its_capture_has_names_them() -> None:
    """What has dimensions beyond those that the layout counts needs a word of its own: CPU times are per such an element."""
    for layout in map(layout_of, LAYOUTS):
        for quantity in layout.quantities:
            same = set(quantity.element_dims) - {"return"} <= {*layout.element}
            assert same or quantity.noun, (layout.name, quantity.name)


def test_without_times_nothing_is_said_of_speed_and_a_vast_multiple_has_no_digits() -> None:
    """Estimates of another program may state no times."""
    table = _chain_rows().iloc[:1].assign(cpu_s=math.nan, wall_s=math.nan, throughput=math.nan, rmse_full=5.0)
    table = table.assign(bound=5.0 / 3779814.79, bound_kind="exact")
    lines, told = closing_lines(table), summary(table)
    assert "over a million x the exact bound" in lines[0]
    assert not any("CPU" in line or "fastest" in line or "–" in line for line in lines + told)


def test_quantities_of_one_name_are_told_apart_in_few_words() -> None:
    """«gated range range» stood in the verdict of a run of three modalities."""
    from types import SimpleNamespace

    keys = [("range", "range", "gated"), ("range", "range", "waveform"), ("column", "line", "laser_line")]
    cells = [SimpleNamespace(quantity=quantity, stage=stage, modality=modality) for quantity, stage, modality in keys]
    assert list(by_quantity(cells)) == ["gated range", "waveform range", "column"]  # type: ignore[arg-type]
    other = SimpleNamespace(quantity="range", stage="fused", modality="gated")
    assert list(by_quantity([*cells, other])) == ["gated range", "waveform range", "column", "gated fused range"]  # type: ignore[list-item]
