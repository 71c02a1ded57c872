"""The card of a data set: what it says is counted again here, a split that leaks is told, and the page loads nothing."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import beambench
from beambench import cli
from beambench.benchmarks.card.card import _share, card_of
from beambench.benchmarks.card.charts import bars
from beambench.benchmarks.card.figures import drawn_of
from beambench.benchmarks.card.leaks import check_split
from beambench.benchmarks.folders.progress import silent
from beambench.captures import open_captures, verify
from beambench.captures.store.shard_set import ShardedSet
from beambench.scenes.datasets.spec import Dataset
from beambench.scenes.errors import InputError

from ._data_sets import TINY, tiny
from ._exports import drawn_set


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_set(
        tmp_path_factory.mktemp("drawn") / "gated-1k", licence="CC0-1.0", title="<b>Steps</b> | & more", citation="Nobody, 2026"
    )  # fmt: skip


def opened(path: Path) -> ShardedSet:
    captures = open_captures(path)
    assert isinstance(captures, ShardedSet)
    return captures


def test_the_card_says_what_is_there(drawn: Path, tmp_path: Path) -> None:
    folder = beambench.data_card(drawn, out=tmp_path / "card")
    text, page = (folder / "card.md").read_text(), (folder / "card.html").read_text()
    assert (
        "| licence | CC0-1.0 |" in text
        and "Nobody, 2026" in text
        and "| train | 20 |" in text
        and "| test | 10 |" in text
    )
    assert (
        "No scene is in two parts: 30 different scenes of 30 captures." in text
        and "All equal the recorded ones" in text
    )
    pictures = re.findall(r"\]\((pictures/[^)]+)\)", text)
    assert len(pictures) >= 6 and all((folder / name).is_file() for name in pictures)
    assert page.count("data:image/") == len(pictures)
    captures = opened(drawn)
    counts = [captures.load(n, ["counts"])["counts"].values for n in range(30)]
    assert f"{min(c.min() for c in counts):g} … {max(c.max() for c in counts):g} DN" in text
    assert f"{np.mean([c.mean() for c in counts]):.4g} DN" in text
    # Text of the file is text: no markup of it reaches the page, and the page may load nothing.
    assert "<b>" not in page and "&lt;b&gt;Steps" in page and r"\<b\>Steps\</b\> \| \& more" in text
    assert "default-src 'none'" in page and "<script" not in page and "http" not in page.replace("http-equiv", "")
    assert verify(drawn) == []


def test_what_is_not_stated_is_not_invented(tmp_path: Path) -> None:
    folder = beambench.data_card(drawn_set(tmp_path / "plain", 6), out=tmp_path / "card")
    text = (folder / "card.md").read_text()
    assert "| licence | not stated |" in text and "| citation | not stated |" in text and text.startswith("# drawn\n")


def test_a_split_that_leaks_is_told(tmp_path: Path) -> None:
    store = drawn_set(tmp_path / "leaky", twin=5)  # 0 is in train, 5 in test
    leaks = check_split([opened(store)], ("target", "medium"), silent)
    assert list(leaks.shared.values()) == [["test", "train"]] and leaks.scenes == 29 and leaks.unlike == 0
    text = (beambench.data_card(store, out=tmp_path / "card") / "card.md").read_text()
    assert "1 scenes are in two parts: the split leaks." in text


def test_hashes_are_computed_anew(drawn: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Recorded hashes that lie (all different, all equal) change what is told of them, not the result."""
    captures = opened(drawn)
    plain = captures.index
    monkeypatch.setattr(captures, "index", lambda place: plain(place) | {"scene_sha256": f"{place:064x}"})
    leaks = check_split([captures], ("target", "medium"), silent)
    assert (leaks.unlike, leaks.scenes, leaks.shared) == (30, 30, {})


def test_nearest_scenes_are_those_of_a_full_search(drawn: Path) -> None:
    leaks = check_split([opened(drawn)], ("target", "medium"), silent)
    albedo = 0.1 + 0.8 * (np.arange(30) * 0.618034 % 1.0)
    part = np.array(["train", "train", "test"] * 10)
    apart = np.abs(albedo[:, None] - albedo[None]) / np.ptp(albedo)
    nearest = apart[np.ix_(part == "test", part == "train")].min(axis=1)
    (near,) = leaks.near
    assert (near.part, near.count) == ("test", 10)
    assert near.least == pytest.approx(nearest.min()) and near.median == pytest.approx(np.median(nearest))
    distance, one, other = near.pairs[0]
    assert part[one] == "test" and part[other] == "train" and apart[one, other] == pytest.approx(distance)
    own = apart[np.ix_(part == "train", part == "train")] + 9 * np.eye(20)
    assert leaks.own == pytest.approx(np.median(own.min(axis=1)))


def test_what_was_drawn_is_held_against_what_was_asked() -> None:
    """A sound draw is within the limit, another distribution beyond it; the asked bins of a uniform are equal."""
    data = Dataset.model_validate(tiny(TINY))
    rng = np.random.default_rng(1)
    sound = {"p.albedo": rng.uniform(0.1, 0.9, 500).tolist(), "p.energy_j": np.geomspace(1e-6, 1e-5, 500).tolist()}
    albedo, energy = drawn_of(data, sound)
    assert albedo.distance < albedo.limit and energy.distance < energy.limit and energy.log and not albedo.log
    # 20,000 quantiles share out to 24 bins: a bin is exact to one of them.
    assert np.allclose(albedo.asked, 500 / 24, atol=500 / 20_000 * 1.01) and albedo.found.sum() == 500
    from scipy.stats import kstest

    exact = kstest(sound["p.albedo"], "uniform", args=(0.1, 0.8)).statistic
    assert albedo.distance == pytest.approx(exact, abs=1 / 20_000)
    (skewed, _) = drawn_of(data, sound | {"p.albedo": rng.triangular(0.1, 0.1, 0.9, 500).tolist()})
    assert skewed.distance > skewed.limit


def test_the_axis_of_whole_numbers_is_linear_and_called_so() -> None:
    """Seeds from 1 to 4e9 have columns of equal width in their value; they were called logarithmic."""
    seeds = {"kind": "integers", "low": 1, "high": 4_000_000_000, "paths": ["target.0.shape.tilt_y_deg"]}
    data = Dataset.model_validate(tiny(TINY, parameters={"shape": seeds}))
    (one,) = drawn_of(data, {"p.shape": [1.0, 2.0e9, 4.0e9]})
    assert not one.log and np.ptp(np.diff(one.edges)) < 1e-6 * one.edges[-1]


def test_shares_are_written_in_full() -> None:
    assert [_share(one) for one in (0.00512, 0.99, 1.0, 12.0, float("nan"))] == [
        "0.51 %",
        "99 %",
        "100 %",
        "1200 %",
        "–",
    ]


def test_charts_escape_their_texts() -> None:
    text = bars("<script>", np.array([0.0, 1.0]), np.array([3.0]), np.empty(0), ["<&>"])
    assert "<script" not in text and "&lt;&amp;&gt;" in text


def test_faults(drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from beambench.captures import write

    from ._exports import capture_of

    store = write(tmp_path / "store", capture_of("gated", 0))
    with pytest.raises(InputError, match="Only a complete data set"):
        card_of(store, silent)
    assert cli.main(["data", "card", str(drawn), "-o", str(drawn / "card")]) == 2
    assert "overwrite an input" in capsys.readouterr().err and verify(drawn) == []
    assert cli.main(["data", "card", str(drawn), "-o", str(tmp_path / "card"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"card.md", "card.html", "run.json"} < set(told["files"])
    assert cli.main(["data", "card", str(drawn), "-o", str(tmp_path / "card")]) == 2
    assert cli.main(["data", "card", str(drawn), "-o", str(tmp_path / "card"), "--overwrite"]) == 0


def test_the_commands_of_the_documents_run(
    drawn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, project: Path
) -> None:
    """Those for exports and the card, as they are typed, on a data set of that name."""
    import shutil

    pytest.importorskip("h5netcdf", reason="needs the extra `netcdf`")
    shutil.copytree(drawn, tmp_path / "gated-1k")
    monkeypatch.chdir(tmp_path)
    text = (project / "docs" / "data-sets.md").read_text(encoding="utf-8")
    typed = re.findall(r"^    beambench ((?:export|data card) .*)$", text, re.MULTILINE)
    assert len(typed) == 6
    for line in typed:
        if "--part validation" in line:
            line = line.replace("validation", "train")  # the small data set has two parts
        assert cli.main(shlex.split(line)) == 0, line
