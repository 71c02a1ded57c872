"""The report page in a headless Chromium: what a click and a key do, narrow windows, printing, accessibility, and equal data."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from beambench.benchmarks.report.page import write_report

from . import _api_fixtures as made_up
from ._browser import CHROMIUM, Browser

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

PAIRS = """\
modality,stage,quantity,condition,a,b,scenes,ratio,ratio_lo,ratio_hi,p,p_holm,winner
gated,range,range,matched,peak,poisson-ml,8,4,3,5,.001,.003,poisson-ml
gated,range,range,matched,peak,parabola,8,1.1,.9,1.3,.4,.4,
gated,range,range,matched,parabola,poisson-ml,8,3.6,3,4,.001,.003,poisson-ml
"""
RUNGS = """\
modality,scene,rung,cpu_s,rel_error,lo,hi
gated,near,direct,.01,.1,.09,.11
gated,near,full,3,.001,,
"""


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with every part that a page can show."""
    folder: Path = made_up.make_run(tmp_path_factory.mktemp("run"), stress=True, side=24)
    rows = pd.read_csv(folder / "scores.csv", keep_default_na=False)
    second = rows[rows["stress"] == "background"].assign(stress="photons")
    pd.concat([rows, second]).to_csv(folder / "scores.csv", index=False)
    (folder / "pairs.csv").write_text(PAIRS)
    (folder / "fidelity").mkdir()
    (folder / "fidelity" / "fidelity.csv").write_text(RUNGS)
    write_report(folder)
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def count(browser: Browser, selector: str) -> int:
    return int(browser.value(f"document.querySelectorAll({selector!r}).length"))


def opacities(browser: Browser, spec: str) -> dict[str, float]:
    """Opacity of the points of a chart, by estimator."""
    code = f"""(() => {{
        const place = document.querySelector('.vega[data-spec="{spec}"]');
        return [...place.querySelectorAll('.mark-symbol path')].filter((p) => p.__data__?.datum?.label)
            .map((p) => [p.__data__.datum.label, Number(p.getAttribute('opacity') ?? 1)]);
    }})()"""
    return {label: float(value) for label, value in browser.value(code)}


def test_it_opens_on_three_charts_without_a_message_or_a_request(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html")
    titles = browser.value(
        "[...document.querySelectorAll('#opening .opening figcaption')].map((c) => c.firstChild.data.trim())"
    )
    assert titles == ["Speed against accuracy", "Breakdown", "Fidelity"]
    places = count(browser, ".vega")
    assert places == 3 + len(made_up.SCENES) + 2 and count(browser, ".vega.drawn svg.marks") == places
    assert browser.messages == []
    assert [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    after = browser.value("[...document.querySelectorAll('main > section')].map((s) => s.id)")
    assert after[:2] == ["opening", "verdict"]


def test_a_chosen_estimator_is_shown_everywhere(run_dir: Path, browser: Browser) -> None:
    """A click on a point of a chart: the charts fade the others, the table is filtered, scenes and error pictures are shown."""
    browser.open(run_dir / "report.html")
    place = browser.value("""(() => {
        const item = [...document.querySelectorAll('.vega[data-spec="chart-0"] .mark-symbol path')]
            .find((p) => p.__data__?.datum?.label === 'peak');
        item.scrollIntoView({block: 'center', behavior: 'instant'});
        const box = item.getBoundingClientRect();
        return [box.x + box.width / 2, box.y + box.height / 2];
    })()""")
    browser.click(*place)
    browser.until("report.label === 'peak'")
    for spec in ("chart-0", "stress-0"):
        browser.until(f"""[...document.querySelectorAll('.vega[data-spec="{spec}"] .mark-symbol path')]
            .some((p) => p.__data__?.datum?.label === 'poisson-ml' && Number(p.getAttribute('opacity')) < 0.5)""")
        assert opacities(browser, spec)["peak"] == 1.0
    shown = (
        "[...document.querySelectorAll('table.scores tbody tr')].filter((r) => !r.hidden).map((r) => r.dataset.label)"
    )
    assert set(browser.value(shown)) == {"peak"}
    scenes = browser.value("[...document.querySelectorAll('#focus article')].map((a) => a.dataset.scene)")
    assert scenes[0] == "flat-wall" and set(scenes) == set(made_up.SCENES)
    assert count(browser, "#focus article figure[data-label=peak] img") == 2 * len(made_up.SCENES)
    assert count(browser, "#focus .bars") == len(made_up.SCENES)
    browser.value("document.querySelector('#focus button.chip').click()")
    assert browser.value("report.label") == "" and browser.value("document.getElementById('focus').hidden")


def test_keys_choose_sort_and_turn(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html")
    browser.value("document.querySelector('table.scores tbody button.pick').focus()")
    label = browser.value("document.activeElement.dataset.label")
    browser.press("Enter")
    assert label and browser.value("report.label") == label
    browser.value("report.choose('')")
    browser.value("document.querySelectorAll('table.scores thead button')[4].focus()")
    keys = "[...document.querySelectorAll('table.scores tbody tr')].map((r) => r.cells[4].dataset.key).filter(Boolean).map(Number)"
    for _ in range(2):
        browser.press(" ")
    falling = browser.value(keys)
    assert falling == sorted(falling, reverse=True) and len(set(falling)) > 3
    assert browser.value("document.activeElement.closest('th').getAttribute('aria-sort')") == "descending"
    canvas = "document.querySelector('.relief canvas')"
    drawn = f"{canvas}.toDataURL()"
    browser.value(f"{canvas}.focus()")
    before, pose = browser.value(drawn), browser.value("document.querySelector('.relief').dataset.pose")
    browser.press("ArrowRight")
    browser.until(f"document.querySelector('.relief').dataset.pose !== {pose!r}")
    assert browser.value(drawn) != before


def test_a_surface_is_dragged_and_shows_the_chosen_estimator(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html")
    box = browser.value("""(() => {
        const canvas = document.querySelectorAll('.relief canvas')[1];
        canvas.scrollIntoView({block: 'center', behavior: 'instant'});
        const b = canvas.getBoundingClientRect();
        return [b.x + b.width / 2, b.y + b.height / 2];
    })()""")
    pose = browser.value("document.querySelector('.relief').dataset.pose")
    browser.drag((box[0], box[1]), (box[0] + 60, box[1] + 10))
    browser.until(f"document.querySelector('.relief').dataset.pose !== {pose!r}")
    browser.value("report.choose('peak')")
    browser.until("document.querySelector('.relief .whose').textContent.startsWith('peak')")


def test_colours_of_an_estimator_are_equal_in_all_charts(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html")
    code = """[...document.querySelectorAll('.vega:not([data-spec^=fidelity]) .mark-symbol path')]
        .filter((p) => p.__data__?.datum?.label)
        .map((p) => [p.__data__.datum.label, getComputedStyle(p).stroke, getComputedStyle(p).fill])"""
    found: dict[str, set[str]] = {}
    for label, stroke, fill in browser.value(code):
        found.setdefault(label, set()).add(stroke if stroke != "none" else fill)
    chips = browser.value("""[...document.querySelectorAll('.legend .pick')]
        .map((c) => [c.dataset.label, getComputedStyle(c.querySelector('path')).fill])""")
    assert {label: {colour} for label, colour in chips} == found
    assert len({colour for _, colour in chips}) == len(made_up.ESTIMATORS)


def test_the_embedded_data_are_the_table_and_the_csv(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html")
    text = (run_dir / "report.csv").read_text(encoding="utf-8")
    assert browser.value("report.csv") == text
    rows = list(csv.DictReader(io.StringIO(text)))
    cells = browser.value("""[...document.querySelectorAll('table.scores tbody tr')].map((r) =>
        [r.dataset.label, r.dataset.scene, r.cells[4].dataset.key, r.cells[5].dataset.key, r.cells[9].dataset.key])""")
    assert len(rows) == len(cells) > 40
    for row, (label, scene, error, coverage, bound) in zip(rows, cells, strict=True):
        assert (row["estimator"], row["scene"]) == (label, scene)
        for mine, theirs, factor in (("rmse_full", error, 1e3), ("coverage", coverage, 1), ("bound", bound, 1e3)):
            assert (row[mine] == "") == (theirs == "")
            if theirs:
                assert float(theirs) == pytest.approx(float(row[mine]) * factor, rel=1e-8)


def test_nothing_scrolls_sideways_on_a_phone(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html", width=420, height=900)
    browser.value("report.choose('weighted-average')")
    assert browser.value("document.documentElement.scrollWidth") <= 420
    # The name beside a scrolled table leaves most of the width to the numbers.
    assert browser.value("document.querySelector('table.scores tbody th').getBoundingClientRect().width") < 160


@pytest.mark.parametrize("dark", [False, True])
def test_print_has_white_pages_and_all_columns(run_dir: Path, browser: Browser, dark: bool) -> None:
    browser.open(run_dir / "report.html", width=1045, dark=dark)
    surface = "document.querySelector('.relief canvas').toDataURL()"
    before = browser.value(surface)
    browser.value("dispatchEvent(new Event('beforeprint'))")
    assert (browser.value(surface) != before) is dark, "lines and letters of surfaces are dark on paper"
    scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
    browser.send("Emulation.setEmulatedMedia", media="print", features=scheme)
    try:
        assert browser.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        # 277 mm of a landscape A4 page are 1,047 px.
        assert browser.value("document.documentElement.scrollWidth") <= 1047
        over = (
            """[...document.querySelectorAll('table')].filter((t) => t.getBoundingClientRect().right > 1047).length"""
        )
        assert browser.value(over) == 0
        assert browser.print().startswith(b"%PDF")
    finally:
        browser.send("Emulation.setEmulatedMedia", media="", features=scheme)


def test_without_scripts_pictures_stand_for_charts(run_dir: Path, browser: Browser) -> None:
    browser.open(run_dir / "report.html", script=False)
    browser.send("Emulation.setScriptExecutionDisabled", value=False)  # for `value`; the page has been read without
    seen = """(s) => [...document.querySelectorAll(s)].filter((e) => e.getBoundingClientRect().height > 0).length"""
    assert browser.value(f"({seen})('.vega, .relief, .filter, select')") == 0
    assert browser.value(f"({seen})('#opening .static svg')") == 3
    assert browser.value(f"({seen})('.static svg')") == 5
    assert browser.value(f"({seen})('#pictures img')") == len(made_up.SCENES) * (1 + 2 * len(made_up.ESTIMATORS))


def test_axe_finds_no_serious_violation(run_dir: Path, browser: Browser) -> None:
    """axe-core (Deque Systems), from the Python package that bundles it."""
    spec = importlib.util.find_spec("axe_core_python")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("axe-core-python of the extra `test` is not installed")
    axe = (Path(spec.submodule_search_locations[0]) / "axe.min.js").read_text(encoding="utf-8")
    ask = "axe.run(document, {resultTypes: ['violations']}).then((r) => JSON.stringify(r.violations.map(" \
          "(v) => [v.impact, v.id, v.nodes.map((n) => n.html.slice(0, 150))])))"  # fmt: skip
    for width, dark in ((1300, False), (420, True)):
        browser.open(run_dir / "report.html", width=width, dark=dark)
        browser.value("report.choose('peak')")
        browser.value(axe + "; 0")
        found: list[Any] = json.loads(browser.value(ask))
        assert [v for v in found if v[0] in ("serious", "critical")] == []
    browser.value(
        "document.querySelector('table').before(Object.assign(document.createElement('img'), {src: 'data:,'}))"
    )
    assert "image-alt" in browser.value(ask), "a planted violation is found"
