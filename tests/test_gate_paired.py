"""The gate on tables whose changes are known: what is red, what passes, and where it abstains."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.gate.check import ABSTAINS, PASS, REGRESSION, Check, decided, equal, measured, verdict
from beambench.benchmarks.gate.figures import Figures, Row, folded, read_baseline, write_baseline
from beambench.benchmarks.gate.paired import Effects, paired_checks
from beambench.benchmarks.gate.stored import memory_checks, setting_differs, yardstick_checks
from beambench.scenes.errors import InputError

HEAD = {
    "suite": "made-up", "suite_version": 1, "split": "test", "tables_version": 3, "commit": "", "written": {},
    "machine": {"processor": "X", "features": "f", "device_class": "cpu", "threads_per_estimator": 1},
    "versions": {"numpy": "2.0"},
}  # fmt: skip
LABELS = ("a", "b", "c", "d", "e", "yard")
SUBJECT = "range"


def figures(
    seeds: int = 10, *, scale: float = 1.0, scatter: float = 0.0, seed: int = 0, tiles: bool = False
) -> Figures:
    """Estimators on two scenes; errors are 1 mm times `scale` with a scatter between cells."""
    rng = np.random.default_rng(seed)
    inputs, rows, tile = {}, {}, {}
    for scene in ("wall", "step"):
        for number in range(seeds):
            cell = (scene, "none", "", "none", "", str(number), "matched")
            inputs[cell] = f"{scene}{number}"
            for label in LABELS:
                factor = scale * math.exp(scatter * rng.normal())
                rows[(label, SUBJECT, "range"), cell] = Row(
                    1000.0, 0.99, 0.02, 1e-3 * factor, 1.0, 0.01 * math.exp(0.02 * rng.normal()), 5e7, "ok"
                )
                if tiles:
                    noise = np.random.default_rng(100 * len(scene) + number).chisquare(16, 64) / 16
                    tile[label, cell] = noise * factor**2 * np.exp(scatter * rng.normal(size=64))
    return Figures(HEAD, inputs, rows, tile)


def states(old: Figures, new: Figures, figure: str) -> set[str]:
    return {check.state for check in decided(paired_checks(old, new, Effects())) if check.figure == figure}


def changed(base: Figures, label: str, **values: object) -> Figures:
    """The figures with some values of one estimator replaced."""
    rows = {
        key: replace(row, **values) if key[0][0] == label else row  # type: ignore[arg-type]
        for key, row in base.rows.items()
    }
    return Figures(base.head, base.inputs, rows, base.tiles)


def test_equal_numbers_pass_and_are_not_tested() -> None:
    checks = decided(paired_checks(figures(), figures(), Effects()))
    assert len(checks) == 4 * len(LABELS)
    assert verdict(checks) == PASS and all(math.isnan(check.p) for check in checks)


def test_five_percent_more_error_is_red_and_one_percent_is_not() -> None:
    base = figures(scatter=0.3)
    rng = np.random.default_rng(4)

    def worse(factor: float) -> Figures:
        rows = {
            k: replace(r, rmse_full=r.rmse_full * factor * math.exp(0.01 * rng.normal())) for k, r in base.rows.items()
        }
        return Figures(base.head, base.inputs, rows)

    assert states(base, worse(1.05), "accuracy") == {REGRESSION}
    assert states(base, worse(1.01), "accuracy") == {PASS}
    assert states(base, worse(0.9), "accuracy") == {PASS}


def test_few_cells_are_compared_by_their_tiles() -> None:
    old, new = figures(1, tiles=True), figures(1, scale=1.08, scatter=0.01, tiles=True, seed=3)
    assert states(old, new, "accuracy") == {REGRESSION}
    # Errors by tile that have nothing in common, of equal size: no change can be shown, and none of 5 % excluded.
    rng = np.random.default_rng(1)
    apart = Figures(
        old.head, old.inputs, {k: replace(r, rmse_full=r.rmse_full * 1.001) for k, r in old.rows.items()},
        {key: rng.chisquare(2, 64) / 2 for key in old.tiles},
    )  # fmt: skip
    assert states(old, apart, "accuracy") == {ABSTAINS}
    assert states(figures(1), figures(1, scale=1.08), "accuracy") == {ABSTAINS}, (
        "no tiles and no cells: nothing is known"
    )


def test_other_captures_are_not_compared() -> None:
    base = figures()
    other = Figures(base.head, dict.fromkeys(base.inputs, "other"), changed(base, "a", rmse_full=9.0).rows)
    checks = decided(paired_checks(base, other, Effects()))
    assert verdict(checks) == ABSTAINS and all("captures" in check.note for check in checks)
    unknown = Figures(base.head, dict.fromkeys(base.inputs, ""), base.rows)
    assert verdict(decided(paired_checks(unknown, unknown, Effects()))) == ABSTAINS


def test_missing_cells_abstain_and_nothing_at_all_is_never_green() -> None:
    base = figures()
    part = Figures(base.head, base.inputs, {k: r for k, r in base.rows.items() if k[1][0] == "wall"})
    assert states(base, part, "accuracy") == {ABSTAINS}
    assert verdict([]) == ABSTAINS


def test_a_crash_is_red_and_a_timeout_is_not_decided() -> None:
    base = figures()
    assert states(base, changed(base, "a", status="crash: SIGSEGV"), "failures") == {REGRESSION, PASS}
    assert states(base, changed(base, "a", status="timeout: call over 60 s"), "failures") == {ABSTAINS, PASS}


@pytest.mark.parametrize(
    ("values", "figure"),
    [
        ({"failure_rate": 0.04}, "failures"),
        ({"coverage": 0.95}, "coverage"),
        ({"z_rms": 1.4}, "sigma"),
        ({"z_rms": 0.7}, "sigma"),
    ],
)
def test_each_figure_turns_red_alone(values: dict[str, float], figure: str) -> None:
    base = figures()
    checks = decided(paired_checks(base, changed(base, "c", **values), Effects()))
    red = {(check.figure, check.subject) for check in checks if check.state == REGRESSION}
    assert red == {(figure, "c · range · matched")}


def test_a_rate_that_few_elements_moved_is_not_red() -> None:
    base = figures(1)
    assert states(base, changed(base, "c", failure_rate=0.025), "failures") == {PASS, ABSTAINS}


def test_memory_of_other_libraries_is_not_compared() -> None:
    base = figures()
    more = changed(base, "b", peak_bytes=8e7)
    rng = np.random.default_rng(2)
    rows = {k: replace(r, peak_bytes=r.peak_bytes * math.exp(0.03 * rng.normal())) for k, r in more.rows.items()}
    noisy = Figures(base.head, base.inputs, rows)
    red = {check.subject for check in decided(memory_checks(base, noisy, Effects())) if check.state == REGRESSION}
    assert red == {"b"}
    other = Figures(HEAD | {"versions": {"numpy": "2.1"}}, base.inputs, more.rows)
    (check,) = memory_checks(base, other, Effects())
    assert check.state == ABSTAINS and "numpy 2.0 -> 2.1" in check.note
    unknown = Figures(HEAD | {"versions": {}}, base.inputs, base.rows)
    assert setting_differs(unknown, unknown, processor=False) == "unknown versions"


def test_the_yardstick_cancels_a_slow_machine_and_needs_the_same_one() -> None:
    base = figures()

    def slower(factors: dict[str, float], head: dict[str, object] = HEAD) -> Figures:
        rows = {
            k: replace(r, cpu_s=r.cpu_s * 1.19 * factors.get(k[0][0], 1.0)) for k, r in figures(seed=7).rows.items()
        }
        return Figures(head, base.inputs, rows)

    assert {c.state for c in decided(yardstick_checks(base, slower({}), "yard", Effects()))} == {PASS}
    red = [
        c.subject
        for c in decided(yardstick_checks(base, slower({"b": 1.5}), "yard", Effects()))
        if c.state == REGRESSION
    ]
    assert red == ["b"]
    elsewhere = slower({}, HEAD | {"machine": {"processor": "Y", "features": "f"}})
    (check,) = yardstick_checks(base, elsewhere, "yard", Effects())
    assert check.state == ABSTAINS and "processor X -> Y" in check.note
    (check,) = yardstick_checks(base, base, "nobody", Effects())
    assert check.state == ABSTAINS


def test_false_alarms_are_bounded_over_the_whole_gate() -> None:
    """2000 gates of 40 checks without any change: at most 1 % is red by the correction, and 3.3 σ of its count."""
    rng = np.random.default_rng(11)
    red = 0
    for _ in range(2000):
        # An effect so small that only p decides.
        checks = [measured("speed", str(k), rng.normal(), 1.0, math.inf, 1e-6) for k in range(40)]
        red += verdict(decided(checks)) == REGRESSION
    assert 0 < red <= 20 + 3.3 * math.sqrt(20), red


def test_equal_checks_do_not_weaken_the_others() -> None:
    one = measured("speed", "a", 0.03, 0.007, math.inf, 0.03)
    assert decided([one])[0].p_holm == decided([one, *[equal("accuracy", str(k), 0.05) for k in range(500)]])[0].p_holm


def test_what_is_certain_and_small_passes_and_what_is_unclear_does_not() -> None:
    assert decided([measured("speed", "a", 0.01, 0.001, math.inf, 0.05)])[0].state == PASS
    assert decided([measured("speed", "a", 0.04, 0.001, math.inf, 0.05)])[0].state == REGRESSION
    found = decided([measured("speed", "a", 0.04, 0.03, math.inf, 0.05)])[0]
    assert found.state == ABSTAINS and "neither be shown nor excluded" in found.note


def test_a_baseline_is_read_as_it_was_written(tmp_path: Path) -> None:
    base = figures(2, tiles=True)
    path = tmp_path / "baseline.json"
    write_baseline(path, base, {"who": "me", "when": "now", "why": "test"}, "abc")
    back = read_baseline(path)
    assert back.head["written"]["why"] == "test" and back.head["commit"] == "abc"
    assert back.inputs == base.inputs and back.rows.keys() == base.rows.keys()
    assert {check.state for check in decided(paired_checks(back, base, Effects()))} == {PASS}
    assert all(check.note == "equal numbers" for check in paired_checks(back, base, Effects()))
    assert path.stat().st_size < 60_000
    for text in ("{", "[]", json.dumps({"format": "x"}), path.read_text().replace('"rows"', '"rouws"')):
        path.write_text(text)
        with pytest.raises(InputError):
            read_baseline(path)
    with pytest.raises(InputError, match="no baseline"):
        read_baseline(tmp_path / "absent.json")


def test_folded_tiles_keep_their_sum_and_their_place() -> None:
    tiles = np.arange(64.0)
    assert folded(tiles, 64) is not None and folded(tiles, 64).size == 64
    four = folded(tiles, 16)
    assert four.sum() == tiles.sum() and four[0] == 0 + 1 + 8 + 9 and four[15] == 54 + 55 + 62 + 63


def test_a_check_has_a_reason_wherever_it_abstains() -> None:
    for check in decided(
        [Check("speed", "a", 0.04, 0.2, 0.05, 0.5), *paired_checks(figures(1), figures(1, scale=2), Effects())]
    ):
        assert check.state != ABSTAINS or check.note
