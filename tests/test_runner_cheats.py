"""A part of the campaign of cheats, with its control, and what the runner says of a slow first call."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from beambench.benchmarks.checks.cheats import CHEATS, verdicts
from beambench.benchmarks.checks.gated_cheats import LEFT
from beambench.benchmarks.folders.files import write_text
from beambench.benchmarks.runner.costs import COST_COLUMNS, quickened, read_costs, slow_starts
from beambench.benchmarks.runner.jail import OFF, abi
from beambench.benchmarks.runner.namespaces import works
from beambench.benchmarks.runner.session import Outcome, Session, run_sessions
from beambench.benchmarks.scores.tables import to_csv
from beambench.scenes.errors import InputError

from .test_benchmarks_runner import LIMITS, spool

BY_NAME = {cheat.place.partition(":")[2]: cheat for cheat in CHEATS}
#: One of each measure that stops cheats.
SOME = ("truth_file", "keeps_the_rig", "input_written", "kept_from_warm_up", "false_events", "process_disguised")


def test_the_campaign_has_forty_cheats_of_four_kinds_with_a_word_for_each() -> None:
    assert len(BY_NAME) == len(CHEATS) >= 40
    assert {cheat.kind for cheat in CHEATS} == {"reach", "time", "score", "left"}


@pytest.mark.skipif(not (abi() and works()), reason="this kernel has no Landlock, or this user no namespaces")
def test_some_cheats_are_stopped() -> None:
    found = {verdict.cheat: verdict for verdict in verdicts([BY_NAME[name] for name in SOME])}
    assert {name for name, verdict in found.items() if verdict.stopped_by} == set(SOME)
    assert found["kept_from_warm_up"].stopped_by.startswith("invalid:")
    assert all(verdict.what.endswith(".") for verdict in found.values())


def test_without_the_jail_the_truth_is_read_and_memory_is_sealed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(OFF, "none")
    found = {verdict.cheat: verdict for verdict in verdicts([BY_NAME["truth_file"], BY_NAME["input_written"]])}
    assert found["truth_file"].got_through and not found["input_written"].got_through


COUNTS = """
import numpy as np, xarray as xr
from beambench.estimators import estimator

SEEN = []

@estimator("gated", cites="planted")
def counts_calls(capture):
    SEEN.append(1)
    shape, dims = capture["counts"].shape[1:], ("row", "col")
    return xr.Dataset({"range": (dims, np.full(shape, float(len(SEEN)))), "sigma": (dims, np.full(shape, 0.1)),
                       "valid": (dims, np.ones(shape, bool))})
"""


@pytest.mark.parametrize("fresh", [False, True])
def test_a_new_child_for_every_capture_remembers_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: bool
) -> None:
    site = tmp_path / "site"
    (site / "counting-1.0.dist-info").mkdir(parents=True)
    (site / "planted_counting.py").write_text(COUNTS)
    (site / "counting-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: counting\nVersion: 1.0\n")
    (site / "counting-1.0.dist-info" / "entry_points.txt").write_text(
        "[beambench.estimators]\ncounts-calls = planted_counting:counts_calls\n"
    )
    monkeypatch.syspath_prepend(str(site))
    seen: list[Outcome] = []
    session = Session("counts-calls", spool(tmp_path, 2), LIMITS, tmp_path / "scratch", fresh_child=fresh)
    run_sessions([session], lambda _, outcome: seen.append(outcome))
    first, second = (float(outcome.arrays["range"][0, 0]) for outcome in seen)
    assert first == 2.0, "the warm-up came before"
    assert (second == first) is fresh


def test_a_first_call_much_slower_than_the_others_is_named() -> None:
    assert not quickened([]) and not quickened([1.0])
    assert quickened([0.1, 0.01, 0.02, 0.01]) and not quickened([0.1, 0.05, 0.06])
    assert not quickened([0.01, 0.001, 0.001]), "some milliseconds may be the machine's"
    row = dict.fromkeys(COST_COLUMNS, "") | {"estimator": "peak", "params": "", "scene": "s", "cpu_s": 0.01}
    (said,) = slow_starts([row | {"cpu_s_first": 0.2}, row | {"cpu_s_first": 0.3}])
    assert said.startswith("peak, s: the first call on new data takes 20 times")
    assert slow_starts([row | {"cpu_s_first": 0.02}, row | {"cpu_s_first": math.nan}]) == []


def test_a_table_of_costs_of_before_has_no_first_calls(tmp_path: Path) -> None:
    old = [name for name in COST_COLUMNS if not name.endswith("_first")]
    write_text(tmp_path / "costs.csv", to_csv([dict.fromkeys(old, 1.0)], old))
    (row,) = read_costs(tmp_path)
    assert row["cpu_s"] == 1.0 and math.isnan(row["cpu_s_first"]) and math.isnan(row["wall_s_first"])
    write_text(
        tmp_path / "costs.csv", to_csv([dict.fromkeys(COST_COLUMNS, "x") | dict.fromkeys(old, 1.0)], COST_COLUMNS)
    )
    with pytest.raises(InputError, match="cannot be read"):
        read_costs(tmp_path)


def test_nothing_of_the_campaign_stays(tmp_path: Path) -> None:
    assert not [path for place in ("/tmp", "/dev/shm", "/var/tmp") for path in Path(place).glob(f"{LEFT}*")]


def test_a_plug_in_has_a_folder_of_compiled_code_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from beambench.benchmarks.runner import process

    shared = tmp_path / "numba" / "abc"
    (shared / "inner").mkdir(parents=True)
    (shared / "inner" / "k.nbi").write_bytes(b"code")
    monkeypatch.setattr(process, "cache_folder", lambda: shared)
    assert process.own_cache("peak") is None and process.own_cache("line-ml+triangulate-refractive") is None
    own = process.own_cache("some-plug-in[value=1]")
    assert own is not None and own == process.own_cache("some-plug-in") != process.own_cache("another-plug-in")
    held = own / "beambench" / "numba" / "abc" / "inner" / "k.nbi"
    assert held.read_bytes() == b"code"
    held.write_bytes(b"planted")
    assert (shared / "inner" / "k.nbi").read_bytes() == b"code"
    assert process.own_cache("some-plug-in") == own and held.read_bytes() == b"planted", "kept from run to run"
