"""A kill while a new result takes the place of an old one: the next start finishes, and moves nothing of others."""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path
from typing import Any

import pytest

from beambench.benchmarks.folders import kinds
from beambench.benchmarks.folders.exchange import refuse_unfinished
from beambench.benchmarks.folders.kinds import Kind
from beambench.benchmarks.folders.workplace import workplace
from beambench.scenes.errors import InputError

from ._folders import a_run, plant, tree


@pytest.mark.parametrize("kind", [kinds.RUN, kinds.ESTIMATE, kinds.REPRODUCE], ids=lambda kind: kind.verb)
def test_an_exchange_that_is_killed_is_finished_by_the_next_start(kind: Kind, tmp_path: Path) -> None:
    files = {
        "run": {
            "run.json": '{"verb": "run"}',
            "scores.csv": "",
            "captures/a.zarr/zarr.json": "",
            "pictures/a__b.npz": "",
        },
        "estimate": {"estimates.json": '{"estimators": ["peak", "a b"]}', "peak.h5": "", "a-b.h5": ""},
        "reproduce": {"run.json": '{"verb": "reproduce"}', "reproduction.csv": "", "pictures/a.png": ""},
    }[kind.verb]
    old = {name: text or "old" for name, text in files.items()} | {"mine.txt": "kept", "replaced": "mine too"}
    new = {name: text or "new" for name, text in files.items()} | {"page.html": "new"}
    last = 2 * len(files) + 1
    for number in range(1, last + 2):
        out = tmp_path / str(number)
        plant(out, old)
        assert _killed_at_rename(number, out, kind, new) == (9 if number <= last else 0)
        if number <= last:
            with pytest.raises(InputError, match="being replaced"):
                refuse_unfinished(out)
        with pytest.raises(InputError, match="not empty"), workplace(out, kind):
            pytest.fail("let in")
        wanted = {name: text.encode() for name, text in (old | new).items()}
        assert tree(out) == wanted, number


def _killed_at_rename(number: int, out: Path, kind: Kind, new: dict[str, str]) -> int:
    """Exit status of a child that replaces `out` and ends at the given rename, as if killed there."""
    child = os.fork()
    if child == 0:
        rename, calls = os.rename, itertools.count(1)
        os.rename = lambda *names: os._exit(9) if next(calls) == number else rename(*names)  # type: ignore[assignment]
        try:
            with workplace(out, kind, overwrite=True) as work:
                plant(work, new)
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.parametrize(
    "change",
    [
        {"old": [["../victim", "replaced/../victim"]]},
        {"old": [["mine.txt", "replaced/mine.txt"]]},
        {"aside": "mine"},
        {"new": [["unfinished/a", "/etc/a"]]},
        {"new": [["link/a", "link/a"]]},
        {"new": [["unfinished/link/a", "link/a"]]},
        {"verb": "sweep"},
        {"old": 3},
    ],
)
def test_a_forged_plan_of_an_exchange_moves_nothing(change: dict[str, Any], tmp_path: Path) -> None:
    plant(tmp_path / "elsewhere", {"a": "kept"})
    out = tmp_path / "run"
    a_run(out)
    plant(out, {"unfinished/a": "x", "unfinished/link/a": "x", "mine/a": "kept"})
    (out / "link").symlink_to(tmp_path / "elsewhere")
    plan = {"verb": "run", "aside": "replaced", "old": [], "new": []} | change
    plant(out, {"exchange.json": json.dumps(plan)})
    before = tree(tmp_path)
    with pytest.raises(InputError, match="plan of an interrupted"), workplace(out, kinds.RUN, overwrite=True):
        pytest.fail("let in")
    assert tree(tmp_path) == before
