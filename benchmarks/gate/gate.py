"""The gate, whole: compare a run with its baseline, time it against another version, decide once over all checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError, other_version
from ..folders.files import write_text
from ..folders.record import now
from ..scores.tables import read_scores
from .against import speed_against
from .check import PASS, Check, abstained, decided, verdict
from .figures import Figures, read_baseline, read_figures, write_baseline
from .outputs import append_history, junit
from .paired import Effects, paired_checks
from .reference import commit_of
from .refusals import no_run, other_suite
from .sides import Plan
from .speed import Timed
from .stored import memory_checks, yardstick_checks

__all__ = ["FIGURES", "GateResult", "gate_run", "update_baseline"]

#: What a gate can check; speed only where it is told how.
FIGURES = ("accuracy", "failures", "coverage", "sigma", "memory", "speed")


@dataclass
class GateResult:
    """Result of a gate.

    verdict: "pass", "regression" or "abstains". checks: all of them, decided. same: the A/A of each timed target, {subject:
    (ln A'/A, half of its 99 % interval)}. notes: what was not asked, and what the baseline does not know.
    """

    verdict: str
    checks: list[Check]
    same: dict[str, tuple[float, float]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    baseline: Path | None = None


def update_baseline(folder: Path, path: Path, *, why: str | None, who: str, project: Path) -> GateResult:
    """Write the baseline of a run, with who, when and why.

    Raises:
        InputError: no reason, no run, a run without hashes of its captures.
    """
    if not (why and why.strip()):
        raise InputError(
            "A baseline is not replaced without a reason.", where="--why", allowed="one sentence for those who read the file",
            next_step="add: --why 'new estimator, errors fall by 8 %'",
        )  # fmt: skip
    if error := no_run(folder, ""):
        raise error
    figures = read_figures(folder)
    if not figures.rows or not all(figures.inputs.values()):
        raise InputError(
            "The run does not state what its estimators read (inputs.csv): nothing could be compared with it.",
            where=str(folder), next_step="run the suite again with this version of beambench",
        )  # fmt: skip
    if path.is_dir():
        raise InputError("The baseline to write is a folder.", where="--baseline", value=str(path), allowed="a file")
    written = {"who": who, "when": now(), "why": why.strip()}
    write_baseline(path, figures, written, commit_of(project))
    return GateResult(
        PASS, [], notes=[f"{len(figures.rows)} rows of {len(figures.inputs)} cells written"], baseline=path
    )


def gate_run(
    folder: Path, baseline: Path, *, against: str | None = None, project: Path, asked: Sequence[str],
    effects: Effects, labels: tuple[str, str] | None = None, yardstick: str | None = None, render: bool = False,
    plan: Plan, outputs: dict[str, Path], tell: Callable[[str], None] = lambda line: None,
) -> GateResult:  # fmt: skip
    """Gate a run.

    Main arguments:
        folder: of the run. baseline: file, or folder of a run. against, project: see `build_reference`. asked: of `FIGURES`.
    Other arguments:
        effects, plan: what is of interest, and how long speed is measured. labels: (new, old), two estimators to compare in
        place of each with itself. yardstick: see `stored`. render: also time the generation of the scenes.
        outputs: {"junit": path, "history": path}. tell: receives lines of progress.

    Raises:
        InputError: bad input.
    """
    old = read_baseline(baseline)
    if error := no_run(folder, str(old.head["suite"])):
        raise error
    whole = read_figures(folder)
    if old.head["suite"] != whole.head["suite"]:
        raise other_suite(folder, baseline, mine=str(whole.head["suite"]), theirs=str(old.head["suite"]))
    if old.head["tables_version"] != whole.head["tables_version"]:
        raise other_version(
            "The baseline's figures follow another version of the tables, in which columns meant something else.",
            where=str(baseline), found=old.head["tables_version"], known=whole.head["tables_version"],
            older=f"beambench gate {folder} --baseline {baseline} --update --why 'tables changed'",
        )  # fmt: skip
    new = whole
    if labels is not None:
        name = f"{labels[0]} against {labels[1]}"
        new, old = whole.of_label(labels[0], name), old.of_label(labels[1], name)
    checks = [check for check in paired_checks(old, new, effects) if check.figure in asked]
    if "memory" in asked:
        checks += memory_checks(old, new, effects)
    timed = _speed(folder, old, new, against, project, asked, effects, yardstick, render, plan, checks, tell)
    final = decided([*checks, *(one.check for one in timed)])
    if not final:
        final = decided([abstained("accuracy", "all", "the baseline and the run have nothing in common")])
    same = {one.check.subject: (one.same, one.same_half) for one in timed if not math.isnan(one.same)}
    result = GateResult(verdict(final), final, same, _notes(old, new, asked, against, yardstick), baseline)
    _write(outputs, result, whole, project)
    return result


def _speed(
    folder: Path, old: Figures, new: Figures, against: str | None, project: Path, asked: Sequence[str], effects: Effects,
    yardstick: str | None, render: bool, plan: Plan, checks: Sequence[Check], tell: Callable[[str], None],
) -> list[Timed]:  # fmt: skip
    if "speed" not in asked:
        return []
    if against is not None:
        return speed_against(
            folder, read_scores(folder), against, project, effects, checks, plan=plan, render=render, tell=tell
        )
    if yardstick is not None:
        return [Timed(check) for check in yardstick_checks(old, new, yardstick, effects)]
    return []


def _notes(old: Figures, new: Figures, asked: Sequence[str], against: str | None, yardstick: str | None) -> list[str]:
    notes = []
    if "speed" not in asked or (against is None and yardstick is None):
        notes.append("speed was not checked: give --against REF or --yardstick LABEL")
    if left := [figure for figure in FIGURES if figure not in asked and figure != "speed"]:
        notes.append(f"not asked for: {', '.join(left)}")
    unknown = sorted({s[0] for s, _ in new.rows} - {s[0] for s, _ in old.rows})
    if unknown:
        notes.append(f"not in the baseline, so not checked: {', '.join(unknown)} (gate --update adds them)")
    written: dict[str, Any] = old.head["written"]
    if written:
        notes.append(f"baseline by {written.get('who')}, {written.get('when')}: {written.get('why')}")
    return notes


def _write(outputs: dict[str, Path], result: GateResult, figures: Figures, project: Path) -> None:
    if (path := outputs.get("junit")) is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, junit(result.checks, str(figures.head["suite"])))
    if (path := outputs.get("history")) is not None:
        append_history(path, figures, now(), commit_of(project))
