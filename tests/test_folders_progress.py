"""Progress as plain lines, with the time that is left."""

from __future__ import annotations

import io

import pytest

from beambench.benchmarks.folders import progress
from beambench.benchmarks.folders.progress import Lines, TimeLeft


def test_the_time_left_is_that_of_the_steps_so_far() -> None:
    left = TimeLeft()
    assert left("a", 0, 10, 100.0) == ""
    assert left("a", 1, 10, 101.0) == ""  # too soon to tell
    assert left("a", 2, 10, 106.9) == ""
    assert left("a", 2, 10, 111.0) == "about 80 s left"
    assert left("b", 1, 4, 110.0) == ""  # a stage of its own
    assert left("a", 4, 104, 131.0) == "about 17 min left"
    assert left("a", 4, 2000, 131.0) == "about 5.5 h left"
    assert left("a", 10, 10, 130.0) == ""


def test_a_stage_that_begins_anew_is_timed_anew() -> None:
    left = TimeLeft()
    left("a", 5, 10, 0.0)
    left("a", 0, 10, 50.0)
    assert left("a", 1, 10, 60.0) == ""
    assert left("a", 2, 10, 70.0) == "about 80 s left"


def test_the_first_step_does_not_count() -> None:
    """It waits for kernels to be compiled: 25 s before the first of 1,000 captures are no sign of seven hours."""
    left = TimeLeft()
    assert left("generate", 0, 1000, 0.0) == "" and left("generate", 1, 1000, 25.0) == ""
    assert left("generate", 101, 1000, 35.0) == "about 90 s left"


def test_lines_tell_it_and_the_last_is_always_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 0.5, 10.0, 10.1, 20.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    out = io.StringIO()
    tell = Lines(out)
    for done in (0, 1, 2, 3, 4):
        tell("design", done, 4, f"step {done}")
    assert out.getvalue().splitlines() == [
        "design 0/4 step 0", "design 2/4 step 2 (about 19 s left)", "design 4/4 step 4",
    ]  # fmt: skip
