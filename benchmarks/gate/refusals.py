"""Why a gate cannot begin: no run, no baseline that can be read, or one of another suite; each with what to do next."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

from ...scenes.errors import InputError
from ..folders.exchange import refuse_unfinished
from ..folders.kinds import verb_in
from ..suites.suite import SUITES

__all__ = ["no_json", "no_run", "other_suite"]


def no_run(folder: Path, suite: str) -> InputError | None:
    """The error of a folder that holds no run, which says how to run the baseline's `suite` ("" where it is not known) into it;
    None where there is a score table, or something else than a folder. Raises InputError in the middle of an exchange."""
    refuse_unfinished(folder)
    if folder.exists() and not folder.is_dir():
        return None
    if any((folder / name).is_file() for name in ("scores.csv", "scores.parquet")):
        return None
    of = f" of the baseline's suite {suite}" if suite else ""
    if verb_in(folder) == "run":
        step = f"finish it: {_run(suite, folder)} --resume"
    elif folder.is_dir() and any(folder.iterdir()):
        step = f"make a run{of} in a new folder: {_run(suite, Path('NEW_FOLDER'))}"
    else:
        step = f"make a run{of} in it: {_run(suite, folder)}"
    return InputError(
        "The folder contains no run." if folder.is_dir() else "There is no such run.",
        where=str(folder), allowed="the folder of a finished run", next_step=step,
    )  # fmt: skip


def other_suite(folder: Path, baseline: Path, *, mine: str, theirs: str) -> InputError:
    """The error of a run of the suite `mine` and a baseline of `theirs`."""
    return InputError(
        "The baseline is of another suite.", where=str(baseline), value=theirs, allowed=f"{mine}, as the run in {folder}",
        next_step=f"make a run of {theirs}: {_run(theirs, Path('NEW_FOLDER'))}; or give {mine} a baseline of its own: "
        f"beambench gate {quote(str(folder))} --baseline NEW.json --update --why 'first baseline of {mine}'",
    )  # fmt: skip


def no_json(baseline: Path, error: ValueError) -> InputError:
    """The error of a baseline that is not text, or no JSON."""
    return InputError(
        "The baseline cannot be read: it is no JSON.", where=str(baseline),
        value=str(error) if baseline.stat().st_size else "an empty file", allowed="a file written by beambench gate --update",
        next_step=f"restore the file from version control, or write it anew: beambench gate RUN --baseline "
        f"{quote(str(baseline))} --update --why 'the file was damaged'",
    )  # fmt: skip


def _run(suite: str, folder: Path) -> str:
    """What to type to run a suite: one that ships by its name, any other one by the file that its authors keep."""
    ships = suite and "/" not in suite and (SUITES / f"{suite}.toml").is_file()
    return f"beambench run {quote(suite) if ships else 'SUITE.toml'} -o {quote(str(folder))}"
