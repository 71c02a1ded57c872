"""`beambench break`: planted bugs are found and shrunk, specs stay within ten lines, and one real find replays."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.checks.breaking import PlantedJudge, check_search, holds, planted_regions
from beambench.benchmarks.checks.gated_planted import DIMENSIONS, region_text, registered
from beambench.benchmarks.run import run_suite
from beambench.benchmarks.search.break_run import break_estimator
from beambench.benchmarks.search.breaker import search_and_shrink, suite_text
from beambench.benchmarks.search.shrink import minimal_axes, shrink
from beambench.benchmarks.search.space import SPACE, Candidate, dimensions_of, draw, ends, mutate
from beambench.benchmarks.suites.stress import AXES, stressed
from beambench.benchmarks.suites.suite import load_suite
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene

SCENES = ("flat-wall", "tilted-wall")


def test_planted_bugs_are_found_and_shrunk() -> None:
    """At least 19 of 20; each find names the axes of its bug and no other, and takes at most ten lines."""
    results = list(check_search(planted_regions(20)))
    assert all(one.judged < 450 for one in results)
    assert all(one.good for one in results if one.found)
    assert sum(one.good for one in results) >= 19


def test_an_estimator_with_a_planted_bug_is_found_on_captures(tmp_path: Path) -> None:
    """A bug at the bright end, in an estimator that runs on generated captures: found, small, and the suite repeats it."""
    region = {"photons": (11 / 12, 1.0)}
    label = f"planted[region={region_text(region)}]"
    with registered():
        result = break_estimator(label, tmp_path, neighbours=["poisson-ml"], scenes=["flat-wall"], side=4, budget=2)
        assert result.found and result.spec is not None and set(result.levels) == {"photons"}
        assert holds(region, Candidate(result.scene, tuple(result.levels.items())))
        assert len(result.spec.read_text(encoding="utf-8").splitlines()) <= 10
        again = {row["estimator"]: row for row in run_suite(result.spec, tmp_path / "again", report=False).rows}
    assert again["planted"]["rmse_full"] == result.rows[0]["rmse_full"] > 5 * again["poisson-ml"]["rmse_full"]


def test_a_found_suite_is_the_scene_of_its_candidate() -> None:
    candidate = Candidate("flat-wall", (("background", 1e6), ("photons", 0.02)))
    overrides = stressed(load_scene("flat-wall"), candidate.levels)[1]
    text = suite_text("break-it", "a note", "flat-wall", overrides, ["peak", "poisson-ml"], 3, "break-it.toml")
    assert load_suite(tomllib.loads(text)).scenes[0][1] == stressed(load_scene("flat-wall"), candidate.levels)[0]


def test_nothing_is_found_in_a_sound_estimator() -> None:
    for seed in range(10):
        search = search_and_shrink(PlantedJudge({"photons": (2.0, 3.0)}), SCENES, SPACE, seed=seed)
        assert search.find is None and math.isfinite(search.worst[1])


def test_one_that_is_always_worse_is_no_find() -> None:
    assert search_and_shrink(lambda candidate, seed: 1.0, SCENES, SPACE, budget=60).find is None


def test_a_failure_of_one_seed_is_no_find() -> None:
    search = search_and_shrink(lambda c, seed: 2.0 * (seed == 0 and bool(c.levels)), SCENES, SPACE, budget=60)
    assert search.find is None


def test_equal_seeds_search_equally() -> None:
    bug = {"photons": (0.0, 0.3), "background": (0.7, 1.0)}
    first, second = (search_and_shrink(PlantedJudge(bug), SCENES, SPACE, seed=5) for _ in range(2))
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
    ("change", "says"),
    [({"neighbours": ["peak"]}, "at least one neighbour"), ({"scenes": ["amcw"], "neighbours": ["amcw-phase"]}, "cannot be judged"),
     ({"budget": 0}, "out of range"), ({"scenes": ["nowhere"]}, "no such"),
     ({"scenes": ["flat-wall", "amcw"]}, "the same modality")],
)  # fmt: skip
def test_bad_searches_are_refused(tmp_path: Path, change: dict[str, object], says: str) -> None:
    from beambench import break_

    with pytest.raises(InputError, match=says):
        break_("peak", out=tmp_path / "find", **change)  # type: ignore[arg-type]
