"""The report page: its contents, safety and independence of the network, and its display in a browser."""

from __future__ import annotations

import math
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from beambench.benchmarks.report.page import write_report
from beambench.scenes.errors import InputError

from . import _api_fixtures as made_up
from ._browser import CHROMIUM

EVIL = "\"></script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\">"


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = made_up.make_run(tmp_path_factory.mktemp("run"), stress=True)
    write_report(folder)
    return folder


@pytest.fixture(scope="module")
def page(run_dir: Path) -> str:
    return (run_dir / "report.html").read_text(encoding="utf-8")


class _Reader(HTMLParser):
    """Elements with their attributes, and the text outside of scripts and styles."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._open = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._open = tag

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open not in {"script", "style"}:
            self.text += data


def read(page: str) -> _Reader:
    reader = _Reader()
    reader.feed(page)
    return reader


def test_it_says_what_was_found(page: str) -> None:
    text = read(page).text
    # Three scenes decide nothing, and what the conditions have is not pooled.
    assert "(matched), poisson-ml has the smallest error" in text and "of 5 others significantly worse" not in text
    assert "the most accurate" not in text and "too few scenes to say which differences are significant" in text
    assert "peak is the fastest" in text
    for name in (*made_up.ESTIMATORS, *made_up.SCENES):
        assert name in text
    assert "A processor" in text and "beambench run made-up --set" in text
    assert "/somewhere/bin" not in text, "the command is shown as typed by name, not by a machine's path"


def test_the_chart_is_saved_beside(run_dir: Path) -> None:
    assert (run_dir / "speed-accuracy.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (run_dir / "speed-accuracy.svg").read_text(encoding="utf-8")
    assert not list(run_dir.glob("*.partial"))


def test_coverage_stands_beside_each_error(page: str) -> None:
    headings = re.findall(r"<th scope=\"col\"[^>]*><button type=\"button\">([^<]*)</button>", page)
    assert headings[headings.index("RMSE, mm") + 1] == "Coverage"


def test_failures_are_listed_with_what_was_said(page: str) -> None:
    assert "step, matched" in page and "crash" in page
    assert "IndexError: &lt;b&gt;index&lt;/b&gt; 64" in page


def test_it_asks_for_nothing(page: str) -> None:
    """No element refers outside the page, and the policy forbids what a library might try."""
    for tag, attributes in read(page).elements:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            value = attributes.get(name)
            if value:
                assert value.startswith(("data:image/png;base64,", "#")), (tag, name, value[:80])
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL)
    assert style is not None
    assert "url(" not in style[1] and "@import" not in style[1]
    assert "default-src 'none'" in page and "unsafe-eval" not in page


def test_elements_of_a_grid_of_stresses_are_all_counted(tmp_path: Path) -> None:
    """Three by three levels of two axes on 1,000 elements are 9,000 elements, whatever the number of estimators."""
    rows = [
        made_up.score_row(stress="photons", level=a, stress2="background", level2=b, n=1_000_000, estimator=name)
        for a in (1, 2, 3)
        for b in (1, 2, 3)
        for name in ("a", "b")
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "scores.csv", index=False)
    text = read(write_report(tmp_path).read_text(encoding="utf-8")).text
    assert "9.00 M pixels with truth" in " ".join(text.split())


def test_a_level_without_any_truth_is_a_gap_in_the_chart(tmp_path: Path) -> None:
    """A wall that turns out of the light: no element has truth, so that the share of failed ones is no number."""
    rows = [made_up.score_row(stress="incidence", level=str(a)) for a in (0, 40)]
    rows.append(made_up.score_row(stress="incidence", level="80", n=0, failure_rate=math.nan, rmse=math.nan))
    pd.DataFrame(rows).to_csv(tmp_path / "scores.csv", index=False)
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert '"failed": null' in page


def test_the_page_tells_the_limit_of_failure(page: str) -> None:
    text = " ".join(read(page).text.split())
    assert "five bounds where that is more, but never more than the width of the echo" in text


def test_pictures_are_described(page: str) -> None:
    images = [attributes for tag, attributes in read(page).elements if tag == "img"]
    assert len(images) == len(made_up.SCENES) * (1 + 2 * len(made_up.ESTIMATORS))
    assert all(attributes.get("alt") for attributes in images)


def test_it_is_small(run_dir: Path) -> None:
    assert (run_dir / "report.html").stat().st_size < 5e6


@pytest.fixture(scope="module")
def evil_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with a hostile table."""
    folder = made_up.make_run(tmp_path_factory.mktemp("evil"), pictures=False)
    table = pd.read_csv(folder / "scores.csv")
    table = table[(table["scene"] == "flat-wall") & (table["seed"] == 0)]
    for column in ("scene", "estimator", "condition", "suite", "stage"):
        table[column] = table[column].astype(str) + EVIL
    table.to_csv(folder / "scores.csv", index=False)
    return write_report(folder)


def test_names_of_strangers_are_escaped(evil_page: Path) -> None:
    """No name becomes an element or ends a script."""
    page = evil_page.read_text(encoding="utf-8")
    tags = read(page).elements
    assert not [tag for tag, attributes in tags if "onerror" in attributes]
    assert len([tag for tag, _ in tags if tag == "script"]) == 6
    assert "title='owned'</script>" not in page


def test_a_table_alone_gives_a_page(tmp_path: Path) -> None:
    """Without run.json and pictures, as `beambench score` leaves it; also one in which nothing worked."""
    nothing = dict.fromkeys(("coverage", "rmse", "rmse_full", "bound", "cpu_s", "wall_s", "throughput"), np.nan)
    rows = [made_up.score_row(estimator=name, status="crash: SIGSEGV", **nothing) for name in ("a", "b")]
    pd.DataFrame(rows).to_csv(tmp_path / "scores.csv", index=False)
    text = read(write_report(tmp_path).read_text(encoding="utf-8")).text
    assert "No estimator gave a result" in text and "SIGSEGV" in text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.json", b"{"),
        ("run.json", b"[]"),
        ("scores.csv", b"a,b\n1,2\n"),
        ("scores.csv", b"\xff\xfe\x00"),
        ("pictures/x__y.npz", b"PK no"),
    ],
)
def test_damaged_input_is_told(tmp_path: Path, name: str, content: bytes) -> None:
    folder = made_up.make_run(tmp_path)
    (folder / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        write_report(folder)
    assert Path(name).name in caught.value.where
    assert not (folder / "report.html").exists()


def test_pictures_cannot_carry_code(tmp_path: Path) -> None:
    folder = made_up.make_run(tmp_path)
    objects = np.array([[object()]], dtype=object)
    np.savez(folder / "pictures" / "x__y.npz", range=objects, truth=objects, error=objects, valid=objects)
    with pytest.raises(InputError):
        write_report(folder)


def browse(page: Path, profile: Path, *flags: str) -> subprocess.CompletedProcess[str]:
    """Open a page in a headless browser without network, and give its output."""
    assert CHROMIUM is not None
    return subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
         "--disable-background-networking", "--disable-component-update", "--disable-sync",
         "--enable-logging=stderr",
         "--host-resolver-rules=MAP * ~NOTFOUND", "--disable-features=NetworkTimeServiceQuerying",
         f"--user-data-dir={profile}", "--virtual-time-budget=8000", "--window-size=1300,1500", *flags, page.as_uri()],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_browser_draws_it(run_dir: Path, page: str, tmp_path: Path) -> None:
    """Every chart is drawn, the console shows no message, and nothing is requested from a network."""
    log = tmp_path / "net.json"
    done = browse(run_dir / "report.html", tmp_path / "profile", "--dump-dom", f"--log-net-log={log}")
    assert done.returncode == 0, done.stderr
    places = page.count('class="vega"')
    assert places == 2 + len(made_up.SCENES), "the first two charts, and one of every scene"
    assert len(re.findall(r'class="vega[^"]*\bdrawn\b', done.stdout)) == places
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert not console, console
    assert not asked_for(log)


def asked_for(log: Path) -> list[str]:
    """Requests of pages in a network log. The browser's own, for its updates, have no origin as initiator."""
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    requests = [line for line in lines if '"initiator":"' in line and '"initiator":"not an origin"' not in line]
    return [line for line in requests if re.search(r'"url":"(?:https?|wss?|ftp)://', line)]


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_request_would_be_seen(tmp_path: Path) -> None:
    """The reader of the log works: a page that does ask is caught."""
    (tmp_path / "page.html").write_text('<img src="http://asked.invalid/x.png">')
    browse(tmp_path / "page.html", tmp_path / "profile", "--dump-dom", f"--log-net-log={tmp_path / 'net.json'}")
    assert asked_for(tmp_path / "net.json")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_browser_runs_no_strange_code(evil_page: Path, tmp_path: Path) -> None:
    done = browse(evil_page, tmp_path / "profile", "--dump-dom")
    assert "<title>made-up" in done.stdout
