"""Wrong versions of the project, planted one at a time: do the tests notice?

    python -m beambench.benchmarks.checks.mutants [--only TEXT] [--jobs N] [--limit SECONDS] [--folder FOLDER]

`mutants.toml` lists the wrong versions: a file, a text that stands in it exactly once, the text in its place, and the tests
that should fail. Sources and tests are copied to a temporary folder, and the copy is edited; the project itself is never
touched. First the named tests must pass in the copy as it is. Then each wrong version is put in, its tests run
until the first failure, and the file is restored.

Printed: wrong version, the test that killed it, seconds. A version whose tests pass has survived; one whose tests do not end
within the limit counts as not killed, since a slow machine is no proof. Exit status 0 where at least 95 % are killed, else 1;
2 where the list or the copy cannot be used.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

from ...scenes.errors import InputError

__all__ = ["LEAST_KILLED", "Mutant", "Outcome", "applied", "copy_project", "read_mutants", "run_mutant"]

#: Share of the wrong versions that the tests must kill.
LEAST_KILLED = 0.95
#: What the tests of a copy need: the floors, of which `api` is the package itself, and what stands beside them.
_FLOORS = ("optics", "scenes", "captures", "generator", "estimators", "benchmarks")
_FOLDERS = (*_FLOORS, "api", "tests", "docs")
_FILES = ("pyproject.toml", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE")
_LIST = Path(__file__).with_name("mutants.toml")
#: pytest's exit status where tests ran and some failed.
_FAILED = 1


@dataclass(frozen=True)
class Mutant:
    """A wrong version: `old`, which stands once in `file` (a path inside the project), becomes `new`; `tests` should fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What the tests did: `killer` is the first test that failed, "" if none did; `ended` is False beyond the limit."""

    mutant: Mutant
    killer: str
    seconds: float
    ended: bool = True


def project_folder() -> Path:
    """The folder of sources and tests. Raises InputError for an installed package, which has no tests."""
    folder = Path(__file__).resolve().parents[2]
    if not (folder / "tests").is_dir() or not (folder / "pyproject.toml").is_file():
        raise InputError(
            "This copy of the project has no tests.", where="benchmarks.checks.mutants", value=str(folder),
            allowed="a checkout with tests/ and pyproject.toml", next_step="run it in a checkout of the sources",
        )  # fmt: skip
    return folder


def read_mutants(path: Path = _LIST) -> list[Mutant]:
    """The list of wrong versions. Raises InputError for an entry that lacks a field or repeats a name."""
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]
        made = [Mutant(e["name"], e["file"], e["old"], e["new"], tuple(e["tests"])) for e in entries]
    except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise InputError(
            "The list of wrong versions cannot be read.", where=str(path), value=str(error),
            allowed="[[mutant]] with name, file, old, new and tests",
        ) from error  # fmt: skip
    names = [mutant.name for mutant in made]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError("Two wrong versions have one name.", where=str(path), value=twice, allowed="different names")
    return made


def applied(mutant: Mutant, source: str) -> str:
    """The text of the file with the wrong version in it.

    Raises InputError where `old` does not stand in `source` exactly once, where nothing would change, or where the result is
    no Python: such a version would be killed by every test.
    """
    count = source.count(mutant.old)
    if count != 1 or mutant.old == mutant.new:
        raise InputError(
            f"The wrong version «{mutant.name}» does not fit its file.", where=mutant.file,
            value=f"{count} × {mutant.old!r}", allowed="exactly once, and a different text in its place",
            next_step="bring its entry in benchmarks/checks/mutants.toml up to date with the source",
        )  # fmt: skip
    wrong = source.replace(mutant.old, mutant.new)
    try:
        ast.parse(wrong, mutant.file)
    except SyntaxError as error:
        raise InputError(
            f"The wrong version «{mutant.name}» is no Python.", where=mutant.file, value=str(error),
            allowed="sources that can be read", next_step="mend `new` of its entry in benchmarks/checks/mutants.toml",
        ) from error  # fmt: skip
    return wrong


def copy_project(project: Path, folder: Path) -> Path:
    """Sources and tests of the project in `folder`, made anew but for compiled functions; `package` links to the sources."""
    skip = shutil.ignore_patterns("__pycache__", "*.pyc")
    for name in _FOLDERS:
        shutil.rmtree(folder / name, ignore_errors=True)
        shutil.copytree(project / name, folder / name, symlinks=True, ignore=skip)
    for name in _FILES:
        shutil.copy2(project / name, folder / name)
    package = folder / "package" / "beambench"
    shutil.rmtree(package, ignore_errors=True)
    package.mkdir(parents=True)
    for place in (*(folder / "api").iterdir(), *(folder / floor for floor in _FLOORS)):
        (package / place.name).symlink_to(place)
    return folder


def _tests(copy: Path, tests: Sequence[str], limit_s: float) -> tuple[int | None, str]:
    """(pytest's exit status, its output) of tests in a copy; (None, "") where the limit is passed."""
    environment = os.environ | {
        "PYTHONPATH": str(copy / "package"), "XDG_CACHE_HOME": str(copy / "cache"), "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    # A whole session of its own, so that the limit also ends what the tests have started.
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=no", *tests],
        cwd=copy, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        output, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return None, ""
    return process.returncode, output


def _failure(output: str) -> str:
    """The first test that failed according to pytest's output, or the output's end."""
    found = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+)", output, re.MULTILINE)
    return found[1] if found else output[-190:]


def check_copy(copy: Path, tests: Sequence[str], limit_s: float) -> None:
    """Raise InputError unless all the tests pass in the copy as it is: else every version would seem killed."""
    status, output = _tests(copy, tests, limit_s)
    if status != 0:
        raise InputError(
            "The tests do not pass in the copy without any wrong version.", where=" ".join(tests),
            value=_failure(output) or f"no end within {limit_s:g} s", allowed="tests that pass",
            next_step="mend the tests first, or raise --limit",
        )  # fmt: skip


def run_mutant(copy: Path, mutant: Mutant, limit_s: float, stamp: int) -> Outcome:
    """Put the wrong version into the copy, run its tests, and restore the file.

    Main arguments:
        copy: a copy of the project. limit_s: of the tests, s. stamp: a number of its own for each call: compiled files are
        recognised by time and length of their source, and a version may be as long as the original.
    Raises InputError where the version does not fit its file, or the tests end in another way than by passing or failing.
    """
    path = copy / mutant.file
    original, times = path.read_text(encoding="utf-8"), path.stat()
    wrong = applied(mutant, original)
    begin = time.perf_counter()
    try:
        path.write_text(wrong, encoding="utf-8")
        os.utime(path, (times.st_atime, times.st_mtime + 10.0 * (stamp + 1)))
        status, output = _tests(copy, mutant.tests, limit_s)
    finally:
        path.write_text(original, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    seconds = time.perf_counter() - begin
    if status not in (0, _FAILED, None):
        raise InputError(
            f"The tests of the wrong version «{mutant.name}» did not run.", where=" ".join(mutant.tests),
            value=_failure(output), allowed="tests that pass or fail",
        )  # fmt: skip
    killer = _failure(output) if status == _FAILED else ""
    return Outcome(mutant, killer, seconds, status is not None)


def _line(outcome: Outcome) -> str:
    verdict = outcome.killer or ("SURVIVED" if outcome.ended else "NO END WITHIN THE LIMIT")
    return f"{outcome.mutant.name:<60}  {verdict:<88}  {outcome.seconds:6.1f}"


def campaign(mutants: Sequence[Mutant], folder: Path, jobs: int, limit_s: float) -> list[Outcome]:
    """Run every version, `jobs` at a time, each in a copy of its own below `folder`; print a line as each ends."""
    project = project_folder()
    for mutant in mutants:  # all faults of the list show before the first test runs
        applied(mutant, (project / mutant.file).read_text(encoding="utf-8"))
    copies: Queue[Path] = Queue()
    for number in range(jobs):
        place = folder / f"copy-{number}"
        place.mkdir(parents=True, exist_ok=True)
        copies.put(copy_project(project, place))
    names = sorted({test for mutant in mutants for test in mutant.tests})
    with ThreadPoolExecutor(jobs) as pool:

        def checked(tests: list[str]) -> None:
            copy = copies.get()
            try:
                check_copy(copy, tests, max(limit_s, 60.0 * len(tests)))
            finally:
                copies.put(copy)

        list(pool.map(checked, [part for part in (names[k::jobs] for k in range(jobs)) if part]))
        print(f"{len(names)} files of tests pass without a wrong version.", flush=True)
        print(f"{'wrong version':<60}  {'killed by':<88}  {'s':>6}", flush=True)

        def one(numbered: tuple[int, Mutant]) -> Outcome:
            copy = copies.get()
            try:
                outcome = run_mutant(copy, numbered[1], limit_s, numbered[0])
            finally:
                copies.put(copy)
            print(_line(outcome), flush=True)
            return outcome

        return list(pool.map(one, enumerate(mutants)))


def _arguments(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m beambench.benchmarks.checks.mutants", description=__doc__)
    parser.add_argument(
        "--only", action="append", metavar="TEXT", help="versions with TEXT in name, file or tests; may be repeated"
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="versions at a time, each in its own copy")
    parser.add_argument("--limit", type=float, default=300.0, metavar="SECONDS", help="of one version's tests")
    parser.add_argument("--folder", default=None, help="keep the copies and their compiled functions there")
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    return parser.parse_args(arguments)


def main(arguments: Sequence[str]) -> int:
    """Run the campaign and print its table; see above."""
    options = _arguments(arguments)
    try:
        texts = options.only or [""]
        chosen = [m for m in read_mutants() if any(t in part for t in texts for part in (m.name, m.file, *m.tests))]
        if not chosen or options.jobs < 1 or not options.limit > 0:
            raise InputError(
                "There is nothing to run.", where="--only, --jobs, --limit",
                value=(texts, options.jobs, options.limit), allowed="a text of some version, 1 or more, above 0 s",
            )  # fmt: skip
        with tempfile.TemporaryDirectory(prefix="beambench-mutants-") as temporary:
            outcomes = campaign(chosen, Path(options.folder or temporary).resolve(), options.jobs, options.limit)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    killed = sum(bool(outcome.killer) for outcome in outcomes)
    share = killed / len(outcomes)
    print(f"{killed} of {len(outcomes)} wrong versions killed: {100.0 * share:.1f} %")
    for outcome in outcomes:
        if not outcome.killer:
            print(f"not killed: {outcome.mutant.name} ({outcome.mutant.file}; {', '.join(outcome.mutant.tests)})")
    return 0 if share >= LEAST_KILLED else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
