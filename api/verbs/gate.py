"""`beambench gate`: a run against its baseline, red for a regression and for nothing else."""

from __future__ import annotations

import getpass
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..scenes.errors import InputError

if TYPE_CHECKING:
    from ..benchmarks.gate.gate import GateResult

__all__ = ["gate"]


def gate(
    folder: str | Path,
    *,
    baseline: str | Path,
    against: str | None = None,
    update: bool = False,
    why: str | None = None,
    who: str | None = None,
    figures: Sequence[str] | None = None,
    new: str | None = None,
    old: str | None = None,
    yardstick: str | None = None,
    render: bool = False,
    project: str | Path = ".",
    accuracy_effect: float = 0.05,
    speed_effect: float = 0.1,
    memory_effect: float = 0.2,
    rate_effect: float = 0.01,
    sigma_effect: float = 0.1,
    starts: int = 8,
    junit: str | Path | None = None,
    history: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> GateResult:
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
        new, old: Compare the estimator `new` of the run with `old` of the baseline, instead of each with itself.
        yardstick: Without `against`: an estimator that did not change, by whose time the stored times are corrected.
        render: With `against`: also time the generation of the scenes.
        project: Folder of the project whose revisions `against` names.
        accuracy_effect: Least relative increase of rmse_full that must not pass.
        speed_effect: The same of CPU time.
        memory_effect: The same of peak memory.
        rate_effect: Least increase of the failure rate, or fall of the coverage, that must not pass.
        sigma_effect: Least relative drift of z_rms away from 1 that must not pass.
        starts: Fresh starts of the processes that are timed, at least 3. More see smaller slowdowns.
        junit: Write the checks as JUnit XML.
        history: Append the run's figures to a CSV file, as Apache Otava reads it.
        progress: Receives lines of progress.

    Returns:
        The result: `verdict` ("pass", "regression", "abstains"), `checks`, `same` (A/A of each timed target) and `notes`.

    Raises:
        InputError: Bad input: no run, no baseline or another suite's, an unknown estimator, revision or figure, no reason.
    """
    from ..benchmarks.gate.gate import FIGURES, gate_run, update_baseline
    from ..benchmarks.gate.paired import Effects
    from ..benchmarks.gate.sides import Plan

    run, kept, home = Path(folder), Path(baseline), Path(project)
    if update:
        return update_baseline(run, kept, why=why, who=who or _user(home), project=home)
    asked = _asked(figures, FIGURES, against, yardstick)
    if (new is None) != (old is None):
        raise InputError("Two estimators are compared, or none.", where="--new, --old", allowed="both, or neither")
    if starts < 3:
        raise InputError("Too few starts for an interval.", where="--starts", value=starts, allowed="3 or more")
    effects = Effects(accuracy_effect, speed_effect, memory_effect, rate_effect, sigma_effect)
    for name, value in vars(effects).items():
        if not 0.0 < value <= 10.0:
            raise InputError(
                "Not an effect of interest.", where=f"the effect on {name}", value=value, allowed="0 < value <= 10"
            )
    return gate_run(
        run, kept, against=against, project=home, asked=asked, effects=effects,
        labels=(new, old) if new is not None and old is not None else None, yardstick=yardstick, render=render,
        plan=Plan(starts=starts), tell=progress or (lambda line: None),
        outputs={"junit": Path(junit) if junit else None, "history": Path(history) if history else None},
    )  # fmt: skip


def _asked(
    figures: Sequence[str] | None, known: Sequence[str], against: str | None, yardstick: str | None
) -> tuple[str, ...]:
    asked = tuple(figures or known)
    if unknown := [name for name in asked if name not in known]:
        raise InputError(
            "There is no such figure to check.", where="--figures", value=unknown[0], allowed=", ".join(known)
        )
    if figures and "speed" in asked and against is None and yardstick is None:
        raise InputError(
            "Speed is checked against something.", where="--figures", value="speed",
            allowed="with --against REF, or with --yardstick LABEL", next_step="add --against main",
        )  # fmt: skip
    return asked


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
