"""`beambench gate`: a run against its baseline, red for a regression and for nothing else."""

from __future__ import annotations

import getpass
import os
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from ..scenes.errors import InputError

if TYPE_CHECKING:
    from ..benchmarks.gate.gate import GateResult
    from ..benchmarks.gate.paired import Effects

__all__ = ["gate"]


def gate(
    folder: str | Path, *, baseline: str | Path, against: str | None = None, update: bool = False, why: str | None = None,
    who: str | None = None, figures: Sequence[str] | None = None, effects: Sequence[str] | None = None,
    new: str | None = None, old: str | None = None, yardstick: str | None = None, render: bool = False,
    project: str | Path = ".", starts: int = 8, junit: str | Path | None = None, history: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> GateResult:  # fmt: skip
    """Compare a run with its baseline, and its speed with another version of the code.

    A regression exits with 1. Where something that was asked cannot be decided, the gate abstains with the reason and exits
    with 3: it is never green when nothing was measured. False alarms are bounded over the whole gate (1 %, Holm).

    Main arguments:
        folder: Folder of the run to check.
        baseline: File that --update wrote, or the folder of another run.
        against: Version to time against: a git revision of `project`, or a wheel. Both are run side by side, in random order,
            with an A/A of the old version beside them.
    Other arguments:
        update: Write the baseline from this run instead of checking it.
        why: Why the baseline changes; it is kept in the file.
        who: Who changes it, by default git's user.name, else the user of this process.
        figures: Check only this: accuracy, failures, coverage, sigma, memory or speed.
        effects: Least change that must not pass, NAME=VALUE. By default accuracy=0.05 (of rmse_full), speed=0.1 (of CPU time),
            memory=0.2 (of the peak), rates=0.01 (of failures and coverage, absolute), sigma=0.1 (drift of z_rms from 1).
        new, old: Compare the estimator `new` of the run with `old` of the baseline, instead of each with itself.
        yardstick: Without `against`: an estimator that did not change, by whose time the stored times are corrected.
        render: With `against`: also time the generation of the scenes.
        project: Folder of the project whose revisions `against` names.
        starts: Fresh starts of the processes that are timed, at least 3. More see smaller slowdowns.
        junit: Write the checks as JUnit XML.
        history: Append the run's figures to a CSV file, as Apache Otava reads it.
        progress: Receives lines of progress.

    Returns:
        The result: `verdict` ("pass", "regression", "abstains"), `checks`, `same` (A/A of each timed target) and `notes`.

    Raises:
        InputError: Bad input: no run, no baseline or another suite's, an unknown estimator, revision or figure, no reason.
    """
    from ..benchmarks.gate.gate import gate_run, update_baseline
    from ..benchmarks.gate.sides import Plan

    run, kept, home = Path(folder), Path(baseline), Path(project)
    if update:
        return update_baseline(run, kept, why=why, who=who or _user(home), project=home)
    return gate_run(
        run, kept, against=against, project=home, asked=_asked(figures, against or yardstick), effects=_effects(effects),
        labels=_labels(new, old), yardstick=yardstick, render=render, plan=Plan(starts=_starts(starts)),
        outputs={name: Path(path) for name, path in (("junit", junit), ("history", history)) if path},
        tell=progress or (lambda line: None),
    )  # fmt: skip


def _asked(figures: Sequence[str] | None, speed_by: str | None) -> tuple[str, ...]:
    from ..benchmarks.gate.gate import FIGURES

    asked = tuple(figures or FIGURES)
    if unknown := [name for name in asked if name not in FIGURES]:
        raise InputError(
            "There is no such figure to check.", where="--figures", value=unknown[0], allowed=", ".join(FIGURES)
        )
    if figures and "speed" in asked and not speed_by:
        raise InputError(
            "Speed is checked against something.", where="--figures", value="speed",
            allowed="with --against REF, or with --yardstick LABEL", next_step="add --against main",
        )  # fmt: skip
    return asked


def _labels(new: str | None, old: str | None) -> tuple[str, str] | None:
    if new is not None and old is not None:
        return new, old
    if new is not None or old is not None:
        raise InputError("Two estimators are compared, or none.", where="--new, --old", allowed="both, or neither")
    return None


def _starts(starts: int) -> int:
    if starts < 3:
        raise InputError("Too few starts for an interval.", where="--starts", value=starts, allowed="3 or more")
    return starts


def _effects(given: Sequence[str] | None) -> Effects:
    from ..benchmarks.gate.paired import Effects

    known = [one.name for one in fields(Effects)]
    values: dict[str, float] = {}
    for text in given or ():
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if name not in known or not 0.0 < value <= 10.0:
            raise InputError(
                "Not an effect of interest.", where="--effects", value=text,
                allowed=f"NAME=VALUE with a name of {', '.join(known)} and 0 < VALUE <= 10", next_step="--effects speed=0.03",
            )  # fmt: skip
        values[name] = value
    return Effects(**values)


def _user(project: Path) -> str:
    """git's user.name in the project, else the user of this process."""
    try:
        found = subprocess.run(
            ["git", "-C", str(project), "config", "user.name"], capture_output=True, text=True, check=False,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        if found.returncode == 0 and found.stdout.strip():
            return found.stdout.strip()
        return getpass.getuser()
    except (OSError, KeyError):
        return f"user {os.getuid()}"
