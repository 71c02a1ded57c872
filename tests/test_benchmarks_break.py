"""`beambench break`: planted bugs are found and shrunk, specs stay within ten lines, and one real find replays."""

from __future__ import annotations

import math
import tomllib
import zlib
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.break_shrink import minimal_axes, shrink
from beambench.benchmarks.break_space import SPACE, Candidate, dimensions_of, draw, ends, mutate
from beambench.benchmarks.breaker import search_and_shrink, suite_text
from beambench.benchmarks.stress import AXES, stressed
from beambench.benchmarks.suite import load_suite
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

DIMENSIONS = {dimension.axis: dimension for dimension in SPACE}
SCENES = ("flat-wall", "tilted-wall")


class Planted:
    """An estimator that is thirty times worse than its neighbours in one region of the space: `low` … `high` of the
    span of each of some axes, all at once. Elsewhere it differs from them by noise, as estimators do."""

    def __init__(self, region: dict[str, tuple[float, float]]) -> None:
        self.region, self.calls = region, 0

    def holds(self, candidate: Candidate) -> bool:
        levels = dict(candidate.levels)
        return all(
            axis in levels and low - 1e-9 <= DIMENSIONS[axis].position(levels[axis]) <= high + 1e-9
            for axis, (low, high) in self.region.items()
        )

    def __call__(self, candidate: Candidate, seed: int) -> float:
        self.calls += 1
        rng = np.random.default_rng([zlib.crc32(repr(candidate).encode()), seed])
        return float(rng.normal(0.1, 0.1)) + (math.log10(30.0) if self.holds(candidate) else 0.0)


def _bugs() -> list[Planted]:
    """Twenty: an end or a window of one axis (a twelfth of its span), of two (a third), of three (half)."""
    rng = np.random.default_rng(20260101)
    bugs = []
    for number in range(20):
        axes = 1 + number % 3
        width = {1: 1 / 12, 2: 1 / 3, 3: 1 / 2}[axes]
        fine = [dimension.axis for dimension in SPACE if not (dimension.coarse and axes == 1)]
        region = {}
        for axis in rng.choice(fine, size=axes, replace=False):
            low = float(rng.choice([0.0, 1.0 - width])) if number % 2 else float(rng.uniform(0.0, 1.0 - width))
            region[str(axis)] = (low, low + width)
        bugs.append(Planted(region))
    return bugs


def test_planted_bugs_are_found_and_shrunk() -> None:
    """At least 19 of 20; each find names the axes of its bug and no other, and takes at most ten lines."""
    found = 0
    for number, bug in enumerate(_bugs()):
        search = search_and_shrink(bug, SCENES, SPACE, seed=number)
        assert bug.calls == search.judged < 450
        if search.find is None:
            continue
        found += 1
        small = search.find.candidate
        assert set(small.axes) == set(bug.region) and bug.holds(small) and small.scene == SCENES[0]
        assert len(small.levels) <= len(search.find.first.levels)
        overrides = stressed(load_scene(small.scene), small.levels)[1]
        text = suite_text("break-it", "a note", small.scene, overrides, ["peak", "poisson-ml"], number, "break-it.toml")
        assert len(text.splitlines()) <= 10
        loaded = load_suite(tomllib.loads(text))
        assert loaded.scenes[0][1] == stressed(load_scene(small.scene), small.levels)[0]
    assert found >= 19


def test_nothing_is_found_in_a_sound_estimator() -> None:
    for seed in range(10):
        search = search_and_shrink(Planted({"photons": (2.0, 3.0)}), SCENES, SPACE, seed=seed)
        assert search.find is None and math.isfinite(search.worst[1])


def test_one_that_is_always_worse_is_no_find() -> None:
    assert search_and_shrink(lambda candidate, seed: 1.0, SCENES, SPACE, budget=60).find is None


def test_a_failure_of_one_seed_is_no_find() -> None:
    search = search_and_shrink(lambda c, seed: 2.0 * (seed == 0 and bool(c.levels)), SCENES, SPACE, budget=60)
    assert search.find is None


def test_equal_seeds_search_equally() -> None:
    bug = {"photons": (0.0, 0.3), "background": (0.7, 1.0)}
    first, second = (search_and_shrink(Planted(bug), SCENES, SPACE, seed=5) for _ in range(2))
    assert first.seen == second.seen and first.find == second.find


def test_impossible_scenes_are_passed_over() -> None:
    def judge(candidate: Candidate, seed: int) -> float:
        if "gain" in candidate.axes:
            return -math.inf
        return 1.5 if "photons" in candidate.axes else math.nan if "jitter" in candidate.axes else 0.0

    search = search_and_shrink(judge, SCENES, SPACE, budget=120)
    assert search.find is not None and search.find.candidate.axes == ("photons",)


def test_delta_debugging_leaves_what_is_needed() -> None:
    axes = [dimension.axis for dimension in SPACE]
    everything = Candidate("flat-wall", tuple(sorted((axis, 1.0) for axis in axes)))
    for needed in ({axes[0]}, set(axes[3:5]), {axes[0], axes[6], axes[11]}, set(axes)):
        small = minimal_axes(everything, lambda candidate, needed=needed: needed <= set(candidate.axes))  # type: ignore[misc]
        assert set(small.axes) == needed


def test_levels_are_made_milder_and_rounder() -> None:
    find = Candidate("tilted-wall", (("background", 7.3e9), ("photons", 0.0021)))
    small = shrink(find, lambda c: dict(c.levels).get("photons", 1.0) < 0.2, SCENES, SPACE)
    ((axis, level),) = small.levels
    # Five halvings of the logarithm leave a 32nd of the way from .0021 to 1.
    assert small.scene == "flat-wall" and axis == "photons" and 0.1 < level < 0.2
    assert level == float(f"{level:.2g}")


def test_the_space_is_that_of_the_stresses() -> None:
    assert set(DIMENSIONS) <= set(AXES)
    scene = load_scene("flat-wall")
    for dimension in SPACE:
        for position in (0.0, 0.5, 1.0):
            level = dimension.level(position)
            assert dimension.low <= level <= dimension.high
            stressed(scene, [(dimension.axis, level)])
            if not dimension.coarse:
                assert dimension.position(level) == pytest.approx(position, abs=0.02)
    assert {d.axis for d in dimensions_of([load_scene("amcw")])} < set(DIMENSIONS)
    rng = np.random.default_rng(0)
    parent = draw(rng, SCENES, SPACE)
    assert parent.levels and mutate(rng, parent, SCENES, SPACE, 0.1) != parent
    assert len(ends("flat-wall", SPACE)) <= 2 * len(SPACE)


def test_a_real_find_replays(tmp_path: Path) -> None:
    """The weighted average without background has a weakness that physics tells: ambient light pulls it to the middle
    of the window. It is found, and the written suite gives the same numbers, bit for bit."""
    from beambench import break_, run

    result = break_(
        "weighted-average", neighbours=["poisson-ml"], scenes=["flat-wall"], side=8, budget=8, out=tmp_path / "find"
    )
    assert result.found and result.spec is not None and result.ratio > 3
    assert len(result.spec.read_text(encoding="utf-8").splitlines()) <= 10
    again = run(result.spec, out=tmp_path / "again", report=False)
    rows = {row["estimator"]: row for row in again.rows}
    for row in result.rows:
        for name in ("rmse_full", "bias", "coverage", "bound"):
            assert rows[row["estimator"]][name] == row[name], (row["estimator"], name)
    assert (result.out / "search.csv").is_file() and (result.out / "run.json").is_file()


@pytest.mark.parametrize(
    ("change", "told"),
    [({"neighbours": ["peak"]}, "against others"), ({"budget": 0}, "cannot be made"), ({"scenes": ["nowhere"]}, "no such"),
     ({"scenes": ["flat-wall", "amcw"]}, "one kind")],
)  # fmt: skip
def test_bad_searches_are_told(tmp_path: Path, change: dict[str, object], told: str) -> None:
    from beambench import break_

    with pytest.raises(InputError, match=told):
        break_("peak", out=tmp_path / "find", **change)  # type: ignore[arg-type]
