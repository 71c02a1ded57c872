"""What becomes of hostile plug-ins: they run beside an honest estimator in a small suite, as a command of its own.

    python -m beambench.benchmarks.checks.plugins [--only PART]

A plug-in is contained if `beambench run` ends with 0, every capture has the rows of the honest estimator as without the plug-in
(all but times and memory), the plug-in has a row with a status for each capture, and nothing is left: no file beside the output,
no temporary folder, no process. Eight run in one command; where something does not hold, each of them runs alone.

One whose package has no readable list of entry points is no estimator at all; there the run must
end with 0 or with 2 and a clear error. The table tells the statuses.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .attempts import Attempts, print_attempts
from .interrupted_work import OF_THE_MACHINE, small_suite
from .traced import Ended, preload, run_forked

__all__ = ["PLUGINS", "Plugin", "Verdict", "contained", "main", "plugins"]

_HONEST = "weighted-average"
#: Marks all processes of an attempt.
_TOKEN = "BEAMBENCH_HOSTILE"
_LIMITS = {"time_s": 3.0, "warmup_s": 20.0, "memory_bytes": 2**30, "output_bytes": 2**20, "give_up_after": 1}


@dataclass(frozen=True)
class Plugin:
    """A hostile plug-in.

    Main arguments:
        name: of its function. module: of this folder, "" where `source` is one.
    Other arguments:
        source: text of a module of its own. points: its list of entry points, where that is what is hostile. runs: whether it is
            an estimator, so that it has rows.
    """

    name: str
    module: str = ""
    source: str = ""
    points: bytes = b""
    runs: bool = True

    @property
    def label(self) -> str:
        """Name of the estimator."""
        return "hostile-" + self.name.replace("_", "-")

    @property
    def what(self) -> str:
        """What it does, in a line."""
        if not self.module:
            return (self.source or repr(self.points)).splitlines()[0].strip("# ")
        from importlib import import_module

        found = getattr(import_module(f"{__package__}.{self.module}"), self.name)
        return str(found.__doc__).strip().split("\n")[0]


@dataclass(frozen=True)
class Verdict:
    """Why a plug-in is not contained, or ""; the statuses of its rows; the most memory of a process of its command."""

    problem: str
    status: str
    peak_bytes: int


#: Plug-ins in one command.
_TOGETHER = 8

_FUNCTION = """
from beambench.benchmarks.checks.gated_cheats import answer, planted
@planted
def estimate(capture):
    return answer(capture)
"""

#: Modules that do harm as they are imported, by name.
_IMPORTED = {
    "import_raises": "# Raise as it is imported.\nraise RuntimeError('\\x1b[2J planted \\udcff')",
    "import_exits": "# Call sys.exit(0) as it is imported.\nimport sys; sys.exit(0)",
    "import_exits_at_once": "# Call os._exit(0) as it is imported.\nimport os; os._exit(0)",
    "import_hangs": "# Sleep as it is imported.\nimport time; time.sleep(600)",
    "import_is_no_python": "# Be no Python.\ndef def def",
    "import_of_zeros": "# Hold bytes of zero.\n\x00\x00",
    "import_prints": "# Print 16 MB as it is imported.\nfor _ in range(4096): print('x' * 4096)" + _FUNCTION,
    "import_interrupts": "# Raise KeyboardInterrupt as it is imported.\nraise KeyboardInterrupt",
    "import_recurses": "# Import itself, reloaded, without an end.\nimport importlib, sys\n"
    "importlib.reload(sys.modules[__name__])",
    "import_forks": "# Fork as it is imported, and go on twice.\nimport os\nos.fork()" + _FUNCTION,
    "import_tells_no_stage": "# Tell the runner a stage that is a list as it is imported.\nimport os, sys\n"
    'os.write(int(sys.argv[3]), b\'{"event": "started", "stage": []}\\n\')' + _FUNCTION,
    "import_without_function": "# Hold no estimator.\nother = 1",
    "import_of_no_function": "# Hold a number in place of the estimator.\nestimate = 7",
    "import_unmarked": "# Hold a function that is not marked.\ndef estimate(capture): return capture",
    "import_lazy": "# Make what is asked for as it is asked.\ndef __getattr__(name): raise SystemExit(0)",
    "import_marks_itself": "# Mark itself with a record of the wrong types.\ndef estimate(capture): return capture\n"
    "estimate.__beambench_estimator__ = 7",
    "import_takes_names": "# Replace the registry and the runner's modules as it is imported.\nimport sys\n"
    "for name in list(sys.modules):\n    if 'runner' in name or 'registry' in name: sys.modules[name] = None",
    "import_closes_files": "# Close all files as it is imported.\nimport os; os.closerange(0, 4096)" + _FUNCTION,
}
#: Lists of entry points that are none.
_POINTS = {
    "points_of_bytes": b"\xff\xfe\x00[beambench.estimators]\n\x80 = \x81\n",
    "points_without_a_value": b"[beambench.estimators]\nhostile\n= x:y\nother =\n",
    "points_of_odd_names": b"[beambench.estimators]\n\x1b[2J\x1b[31m = os:getcwd\n"
    + b"n" * 100_000
    + b" = os:getcwd\n",
    "points_named_as_a_built_in": b"[beambench.estimators]\npeak = os:getcwd\n",
}


def _all(module: str) -> Iterator[Plugin]:
    from importlib import import_module

    found = vars(import_module(f"{__package__}.{module}"))
    for name, held in found.items():
        if (
            not name.startswith("_")
            and name != "planted"
            and getattr(held, "__module__", "") == f"{__package__}.{module}"
        ):
            yield Plugin(name, module)


def _listed() -> dict[str, Plugin]:
    made = [plugin for module in ("planted_answers", "planted_ends", "planted_tampering") for plugin in _all(module)]
    made += [Plugin(name, source=source) for name, source in _IMPORTED.items()]
    made += [Plugin(name, points=points, runs=False) for name, points in _POINTS.items()]
    return {plugin.name: plugin for plugin in made}


#: All plug-ins by name.
PLUGINS = _listed()


@contextmanager
def _installed(plugin: Plugin, place: Path) -> Iterator[None]:
    """Within the block the plug-in, a package of its own, is installed for this process and those that it starts."""
    site = Path(tempfile.mkdtemp(prefix="site-", dir=place))
    info = site / f"{plugin.name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {plugin.name}\nVersion: 1.0\n")
    module = f"bb_{plugin.name}"
    (site / f"{module}.py").write_text(plugin.source)
    target = f"beambench.benchmarks.checks.{plugin.module}:{plugin.name}" if plugin.module else f"{module}:estimate"
    points = f"[beambench.estimators]\n{plugin.label} = {target}\n".encode()
    (info / "entry_points.txt").write_bytes(plugin.points or points)
    sys.path.insert(0, str(site))
    try:
        yield
    finally:
        sys.path.remove(str(site))


def plugins(only: str = "") -> list[Attempts]:
    """Run the plug-ins whose names or modules contain `only`."""
    preload()
    parts: dict[str, Attempts] = {}
    with tempfile.TemporaryDirectory(prefix="beambench-hostile-") as folder:
        place = Path(folder)
        honest = _run([_HONEST], place)
        expected = _rows(place, _HONEST)
        if honest.code != 0 or not expected:
            raise RuntimeError(f"the honest estimator alone: exit {honest.code}: {honest.text[-300:]}")
        for plugin, verdict in _verdicts(
            [one for one in PLUGINS.values() if only in one.name or only in one.module], expected, place
        ):
            name = (plugin.module or plugin.name.partition("_")[0]).removeprefix("planted_")
            part = parts.setdefault(name, Attempts(name))
            part.used(verdict.peak_bytes)
            print(f"{plugin.name}: {plugin.what} {verdict.problem or verdict.status}", file=sys.stderr, flush=True)
            part.failed(f"{plugin.name}: {verdict.problem}") if verdict.problem else part.held(
                verdict.status.partition(":")[0]
            )
    return list(parts.values())


def _verdicts(chosen: list[Plugin], expected: list[dict[str, Any]], place: Path) -> Iterator[tuple[Plugin, Verdict]]:
    """Each plug-in and its verdict; those that are estimators several at a time."""
    together = [plugin for plugin in chosen if plugin.runs]
    batches = [together[first : first + _TOGETHER] for first in range(0, len(together), _TOGETHER)]
    for batch in [*batches, *([plugin] for plugin in chosen if not plugin.runs)]:
        found = contained(batch, expected, place)
        if len(batch) > 1 and any(verdict.problem for verdict in found):
            found = [contained([plugin], expected, place)[0] for plugin in batch]
        yield from zip(batch, found, strict=True)


def contained(batch: Sequence[Plugin], expected: list[dict[str, Any]], place: Path) -> list[Verdict]:
    """The verdicts of plug-ins that run in one command; `expected`: the rows of the honest estimator alone."""
    with ExitStack() as installed:
        for plugin in batch:
            installed.enter_context(_installed(plugin, place))
        ended = _run([_HONEST, *(plugin.label for plugin in batch if plugin.runs)], place)
    problem = _problem(ended, expected, place)
    refused = ended.code == 2 and "Traceback" not in ended.text
    found = []
    for plugin in batch:
        own = _rows(place, plugin.label)
        said = "; ".join(sorted({row["status"] for row in own}))
        if not plugin.runs:
            said = "refused at the start" if refused else "no estimator"
            found.append(Verdict("" if refused else problem, said, ended.peak_bytes))
            continue
        count = "" if len(own) == len(expected) else f"{len(own)} rows of its own, not {len(expected)}"
        found.append(Verdict(problem or count, said, ended.peak_bytes))
    return found


def _problem(ended: Ended, expected: list[dict[str, Any]], place: Path) -> str:
    """What did not hold of a command, but the rows of the plug-ins; ""."""
    left = [*_processes(), *(path.name for path in (place / "tmp").iterdir())]
    if ended.code is None:
        return "it hung"
    if ended.code != 0:
        return f"exit {ended.code}: {ended.text[-300:]!r}"
    if _rows(place, _HONEST) != expected:
        return "other rows are not as they were"
    if (place / "guard.txt").read_text() != "mine":
        return "a file of others was changed"
    return f"left: {left}" if left else ""


def _run(labels: list[str], place: Path) -> Ended:
    """`beambench run` of the small suite in a process of its own."""
    for name in ("out", "tmp"):
        shutil.rmtree(place / name, ignore_errors=True)
    (place / "tmp").mkdir()
    (place / "guard.txt").write_text("mine")
    suite = small_suite() | {"estimators": labels, "limits": _LIMITS}
    suite["stresses"] = [{"axis": "photons", "values": [10.0]}]
    (place / "suite.json").write_text(json.dumps(suite))
    words = ["run", str(place / "suite.json"), "--out", str(place / "out"), "--no-report"]
    return run_forked(words, place, environment={"TMPDIR": str(place / "tmp"), _TOKEN: "1"})


def _rows(place: Path, label: str) -> list[dict[str, Any]]:
    """The rows of an estimator without times and memory; none where there is no table."""
    file = place / "out" / "scores.csv"
    if not file.is_file():
        return []
    with open(file, encoding="utf-8", newline="") as lines:
        rows = [row for row in csv.DictReader(lines) if row["estimator"] == label]
    return [{key: row[key] for key in row if key not in OF_THE_MACHINE} for row in rows]


def _processes() -> list[str]:
    """Processes of the attempt that are still there; they are killed."""
    import psutil

    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error, OSError):
            if process.pid != os.getpid() and process.status() != psutil.STATUS_ZOMBIE and _TOKEN in process.environ():
                found.append(f"process {process.pid}")
                process.kill()
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign and print its table. Returns 1 where a plug-in was not contained."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="part of the name of a plug-in or its module")
    only = parser.parse_args(arguments).only
    return print_attempts(plugins(only))


if __name__ == "__main__":
    sys.exit(main())
