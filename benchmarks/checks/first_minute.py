"""The first minute of a newcomer: install, first quickstart and second quickstart, as ratios in one run.

    python -m beambench.benchmarks.checks.first_minute --source .

A fresh virtual environment, with empty caches of packages and of compiled kernels. Wanted, as ratios of wall times:

- first quickstart ≤ its own install;
- second quickstart ≤ half of the first;
- something to look at within 20 s of the first quickstart: the first result that is told;
- `beambench --help` ≤ .4 s on a quiet machine; on any machine its ratio to `python -c pass` is told.

Times of a busy machine say little, so its load is told too. The exit code is 1 where a ratio is above what is wanted.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Timed", "main", "measured", "verdicts"]

#: Variables that would lend the newcomer what another project has set or compiled.
_OTHERS = re.compile(r"^(PYTHON|NUMBA|DRJIT|BEAMBENCH|XDG_|VIRTUAL_ENV|PIP_CACHE|TMPDIR)")
_RESULT = re.compile(r"^estimate +\d+/\d+ .*: ")
_HELP_REPEATS = 7
FIRST_RESULT_S, HELP_S = 20.0, 0.4


@dataclass(frozen=True)
class Timed:
    """Wall time and CPU time of a command and its children, s; wall time until a line of `seen` came, None where none did."""

    wall_s: float
    cpu_s: float
    seen_s: float | None = None


def measured(command: Sequence[str], cwd: Path, env: dict[str, str], seen: re.Pattern[str] | None = None) -> Timed:
    """Run a command and time it. Raises RuntimeError with the end of its output where it fails."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.perf_counter()
    first: float | None = None
    lines: list[str] = []
    with subprocess.Popen(
        command, cwd=cwd, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            lines.append(line)
            if first is None and seen is not None and seen.match(line):
                first = time.perf_counter() - begun
    wall = time.perf_counter() - begun
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}\n{''.join(lines[-30:])}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Timed(wall, cpu, first)


def newcomer(folder: Path) -> dict[str, str]:
    """The environment of somebody whose caches are empty: this one, without what is set for Python, in a home of its own."""
    kept = {name: value for name, value in os.environ.items() if not _OTHERS.match(name)}
    own = {"HOME": "home", "XDG_CACHE_HOME": "cache", "PIP_CACHE_DIR": "packages", "TMPDIR": "tmp"}
    for place in own.values():
        (folder / place).mkdir(exist_ok=True)
    return kept | {name: str(folder / place) for name, place in own.items()} | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"}


def verdicts(install: Timed, first: Timed, second: Timed, help_s: float, bare_s: float) -> list[tuple[str, str, bool]]:
    """(what, measured beside wanted, met) of each wish."""
    look = first.seen_s
    return [
        ("first quickstart / install", f"{first.wall_s / install.wall_s:.2f} (≤ 1)", first.wall_s <= install.wall_s),
        (
            "second / first quickstart",
            f"{second.wall_s / first.wall_s:.2f} (≤ 0.5)",
            second.wall_s <= 0.5 * first.wall_s,
        ),
        (
            "first result of the first quickstart",
            "none was told" if look is None else f"{look:.1f} s (≤ {FIRST_RESULT_S:g} s)",
            look is not None and look <= FIRST_RESULT_S,
        ),
        ("--help", f"{help_s:.2f} s, {help_s / bare_s:.1f} × python -c pass (≤ {HELP_S:g} s, quiet)", help_s <= HELP_S),
    ]


def _load() -> str:
    return " ".join(f"{one:.1f}" for one in os.getloadavg())


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default=".", help="what is installed: the project's folder, or a wheel")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the fresh environment")
    parser.add_argument("--suite", default="quickstart")
    given = parser.parse_args(arguments)
    source = Path(given.source).resolve()
    limits = source / "constraints.txt"
    with tempfile.TemporaryDirectory(prefix="first-minute-") as name:
        folder = Path(name)
        env = newcomer(folder)
        print(f"load averages before: {_load()}", flush=True)
        made = measured([given.python, "-m", "venv", str(folder / "venv")], folder, env)
        command = [str(folder / "venv" / "bin" / "pip"), "install", "-q", str(source)]
        command += ["-c", str(limits)] if limits.is_file() else []
        pip = measured(command, folder, env)
        install = Timed(made.wall_s + pip.wall_s, made.cpu_s + pip.cpu_s)
        print(f"install            {install.wall_s:7.1f} s wall {install.cpu_s:7.1f} s CPU", flush=True)
        python, bench = (str(folder / "venv" / "bin" / program) for program in ("python", "beambench"))
        bare, helped = [], []
        measured([bench, "--help"], folder, env)  # writes bytecode
        for _ in range(_HELP_REPEATS):
            bare.append(measured([python, "-c", "pass"], folder, env).wall_s)
            helped.append(measured([bench, "--help"], folder, env).wall_s)
        runs = []
        for title in ("first", "second"):
            run = measured([bench, "run", given.suite, "-o", str(folder / title)], folder, env, _RESULT)
            look = "" if run.seen_s is None else f", first result after {run.seen_s:.1f} s"
            print(f"{title:6} {given.suite:11} {run.wall_s:7.1f} s wall {run.cpu_s:7.1f} s CPU{look}", flush=True)
            runs.append(run)
        print(f"load averages after:  {_load()}")
        found = verdicts(install, runs[0], runs[1], help_s=statistics.median(helped), bare_s=statistics.median(bare))
        for what, value, met in found:
            print(f"{'met    ' if met else 'not met'} {what}: {value}")
        print(
            f"CPU: first / install {runs[0].cpu_s / install.cpu_s:.2f}, second / first {runs[1].cpu_s / runs[0].cpu_s:.2f}"
        )
    return 0 if all(met for _, _, met in found) else 1


if __name__ == "__main__":
    raise SystemExit(main())
