"""What becomes of estimators that cheat: each is run as a plug-in on a small suite, and the run is looked at afterwards.

    python -m beambench.benchmarks.checks.cheats [FILE.csv] [--only NAME...]

BEAMBENCH_ISOLATION=none shows the same cheats without the jail. Columns: cheat; what it does; `stopped_by`, the measure that kept
it from its gain; `flagged_by`, what marks its row; `got_through`, "yes" where it gained and nothing marks it. A cheat that reaches
for something has gained if it got it; one of time, if its median call took less than half of the work it owes; one of scores, if
its mean square error is below .8 of the honest estimator's (a guess: of refusing everything); one that leaves something, if that
is there after the run.

The suite: three captures of a rough wall, each at a distance drawn for it, under the conditions matched and calibrated.
"""

from __future__ import annotations

import csv
import json
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..judges.bound import bounds_of, truths_of
from ..runner.costs import quickened
from ..runner.jail import OFF, isolation
from ..runner.session import Job, Outcome, Session, run_sessions
from ..runner.spool import Entry, Spool
from ..scores.resolution import gives_up, pooled_response, resolution_rows
from ..scores.score import score_rows
from ..scores.truth import refusal_error, single_valued
from ..statistics.suspects import suspicion
from ..suites.spec import Limits
from ..suites.suite import Cell
from .gated_cheats import FACTS, REACHED, WORK_S
from .planted_scene import Around, captures

__all__ = ["CHEATS", "Cheat", "Verdict", "verdicts"]

_SEEDS = (1, 2, 3)
_LIMITS = Limits(time_s=120.0, warmup_s=600.0, memory_bytes=2**31)
_COLUMNS = ("cheat", "what", "stopped_by", "flagged_by", "got_through")
_NAMESPACE, _LANDLOCK, _SEALED = "own namespaces", "Landlock", "sealed memory"
_CLOCK, _FRESH, _PROCESS = "the parent's clocks", "other data at every call", "a process for each condition"


@dataclass(frozen=True)
class Cheat:
    """A cheat: its function as "module:name", its kind (reach, time, score, left), and the measure that is to stop it."""

    place: str
    kind: str
    measure: str
    both: bool = False  # under both conditions

    @property
    def label(self) -> str:
        """Name of the estimator."""
        return "cheat-" + self.place.partition(":")[2].replace("_", "-")


@dataclass(frozen=True)
class Verdict:
    """What became of a cheat."""

    cheat: str
    what: str
    stopped_by: str = ""
    flagged_by: str = ""

    @property
    def got_through(self) -> bool:
        """Whether it gained and nothing marks it."""
        return not (self.stopped_by or self.flagged_by)


def _all(module: str, kind: str, **names: str) -> list[Cheat]:
    return [Cheat(f"{module}:{name}", kind, measure) for name, measure in names.items()]


CHEATS: tuple[Cheat, ...] = (
    *_all(
        "planted_reach", "reach", truth_file=_LANDLOCK, output_folder=_LANDLOCK, other_captures=_LANDLOCK, generator=_LANDLOCK,
        scene_library=_LANDLOCK, suite_library=_LANDLOCK, earlier_runs=_LANDLOCK, parent_environment=_NAMESPACE,
        parent_memory=_NAMESPACE, parent_traced=_NAMESPACE, other_processes=_NAMESPACE, signals_parent=_NAMESPACE,
        signals_sibling=_NAMESPACE, tcp=_NAMESPACE, udp=_NAMESPACE, abstract_socket=_NAMESPACE, named_socket=_LANDLOCK,
        input_written=_SEALED, spool_forged=_LANDLOCK, results_poisoned=_LANDLOCK, kernels_planted=_LANDLOCK,
        package_changed=_LANDLOCK,
    ),
    Cheat("planted_reach:matched_rig", "reach", _LANDLOCK, both=True),
    Cheat("planted_reach:notes_between_conditions", "reach", _LANDLOCK, both=True),
    Cheat("planted_conduct:keeps_the_rig", "reach", _PROCESS, both=True),
    *_all(
        "planted_conduct", "time", clocks_stopped=_CLOCK, kept_by_input=_FRESH, kept_from_warm_up=_FRESH, kept_by_likeness="",
        helper_unreaped=_CLOCK, helper_detached=_CLOCK, work_after_the_call=_CLOCK, false_events=_CLOCK,
        thread_between_calls=_CLOCK,
    ),
    *_all(
        "planted_conduct", "score", knows_the_truth=_FRESH, knows_the_truth_nearly="", smooths="", pools_captures="a pose per seed",
        guesses="the cost of a refusal",
    ),
    *_all(
        "planted_conduct", "left", process_in_its_session=_NAMESPACE, process_forked_twice=_NAMESPACE,
        process_disguised=_NAMESPACE, shared_memory=_NAMESPACE, semaphore=_NAMESPACE, temporary_folders=_LANDLOCK,
    ),
)  # fmt: skip


@contextmanager
def _registered(cheats: Iterable[Cheat]) -> Iterator[None]:
    """Within the block the cheats, and an honest estimator, are plug-ins of this process and its children."""
    with tempfile.TemporaryDirectory(prefix="beambench-planted-") as folder:
        info = Path(folder) / "beambench_cheats-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: beambench_cheats\nVersion: 1.0\n")
        lines = [f"{cheat.label} = beambench.benchmarks.checks.{cheat.place}" for cheat in cheats]
        (info / "entry_points.txt").write_text("\n".join(["[beambench.estimators]", *lines, ""]))
        sys.path.insert(0, folder)
        try:
            yield
        finally:
            sys.path.remove(folder)


def verdicts(cheats: Sequence[Cheat] = CHEATS) -> Iterator[Verdict]:
    """Run the cheats, one child for each and for each condition, and say what became of each."""
    scene, made = captures(_SEEDS)
    with ExitStack() as held:
        held.enter_context(_registered([*cheats, _HONEST]))
        spool = held.enter_context(Spool())
        around = held.enter_context(Around(spool, made))
        os.environ[FACTS] = json.dumps(around.facts)
        held.callback(os.environ.pop, FACTS, None)
        entries = [_spooled(spool, index, scene, capture) for index, capture in enumerate(made)]
        compared = any(cheat.kind == "score" for cheat in cheats)
        honest = _outcomes(_HONEST, entries, spool) if compared else []
        for cheat in cheats:
            yield _verdict(cheat, _outcomes(cheat, entries, spool), honest, entries, spool, around)


_HONEST = Cheat("planted_conduct:honest", "score", "")


def _spooled(spool: Spool, index: int, scene: Any, capture: xr.Dataset) -> Entry:
    cell = Cell("wall", scene, "none", math.nan, "none", math.nan, _SEEDS[index], index)
    rig = json.loads(str(capture.attrs["rig"]))
    rig["t0_s"] += 2e-11  # a calibration with an error of 3 mm
    text = json.dumps(rig)
    conditions = {"matched": lambda seen: seen, "calibrated": lambda seen: seen.assign_attrs(rig=text)}
    return spool.add(index, cell, capture, conditions, truths_of(capture), Around.drawn(bounds_of(capture)))


def _outcomes(cheat: Cheat, entries: list[Entry], spool: Spool) -> list[Outcome]:
    """The answers of one estimator, each condition in a child of its own, as in a run."""
    conditions = ("matched", "calibrated") if cheat.both else ("matched",)
    used = entries if cheat.kind == "score" else entries[:1]
    found: list[Outcome] = []
    for condition in conditions:  # one after the other, so that the first can leave something for the second
        jobs = [
            Job(e.index, e.folder, condition, e.modality, e.sizes, timed=cheat.kind in ("time", "score")) for e in used
        ]
        place = spool.open / f"estimator-{cheat.label}-{condition}"
        session = Session(cheat.label, jobs, _LIMITS, place, hidden=(spool.closed,))
        run_sessions([session], lambda _, outcome: found.append(outcome))
    return found


def _verdict(
    cheat: Cheat, outcomes: list[Outcome], honest: list[Outcome], entries: list[Entry], spool: Spool, around: Around
) -> Verdict:
    name = cheat.place.partition(":")[2]
    verdict = Verdict(name, _what(cheat))
    ways: dict[str, Callable[[list[Outcome]], bool]] = {
        "reach": _reached, "time": _faster, "left": lambda _: bool(around.left()),
    }  # fmt: skip
    gained = ways.get(cheat.kind)
    failed = sorted({outcome.status for outcome in outcomes if outcome.status != "ok"})
    if gained is None:
        flags, better = _scores(outcomes, honest, entries, spool)
        if better and not failed:
            return Verdict(name, verdict.what, flagged_by=flags)
    elif gained(outcomes) and (cheat.kind == "left" or not failed):
        return Verdict(name, verdict.what, flagged_by=_slow_start(outcomes) if cheat.kind == "time" else "")
    measure = cheat.measure or "no gain"
    if os.environ.get(OFF) == "none" and measure in (_LANDLOCK, _NAMESPACE):
        measure = "the supervisor of the child" if cheat.kind == "left" else "no gain"
    return Verdict(name, verdict.what, stopped_by="; ".join(failed) or measure)


@lru_cache(maxsize=2)
def _module(name: str) -> Any:
    from importlib import import_module

    return import_module(f"{__package__}.{name}")


def _what(cheat: Cheat) -> str:
    module, _, name = cheat.place.partition(":")
    found = getattr(_module(module), name)
    return str(found.__doc__ or "").strip().split("\n")[0]


def _reached(outcomes: list[Outcome]) -> bool:
    return any(outcome.status == "ok" and bool((outcome.arrays["range"] == REACHED).all()) for outcome in outcomes)


def _faster(outcomes: list[Outcome]) -> bool:
    """Whether a call seems to take less than half of the work that an answer needs."""
    return any(min(outcome.cpu_s, outcome.wall_s) < 0.5 * WORK_S for outcome in outcomes if outcome.status == "ok")


def _slow_start(outcomes: list[Outcome]) -> str:
    return "first call in costs.csv" if any(quickened(o.cpu_calls) or quickened(o.wall_calls) for o in outcomes) else ""


def _scores(outcomes: list[Outcome], honest: list[Outcome], entries: list[Entry], spool: Spool) -> tuple[str, bool]:
    """(what marks the rows, whether the mean square over the captures is below .8 of the honest one's)."""
    flags: list[str] = []
    kept: list[dict[str, Any]] = []
    square = []
    for found in (outcomes, honest):
        total = 0.0
        for outcome in found:
            truth, bound = spool.truth(entries[outcome.job.index])
            (row, *_) = score_rows(_KEY, outcome.stage, truth, bound, outcome.arrays or None, status=outcome.status)
            total += float(row["rmse_full"]) ** 2
            if found is outcomes:
                flags.append(suspicion(row["rmse"], row["bound"], row["n"], row["bound_kind"]))
                kept += resolution_rows(_KEY, outcome.stage, outcome.arrays, truth) if outcome.arrays else []
        square.append(total / len(found))
    guess = sum(_refusal(entry, spool) ** 2 for entry in entries) / len(entries)
    # A guess gains where it costs less than to refuse everything.
    compared = guess if _constant(outcomes) else square[1]
    if gives_up(share := pooled_response(kept)):
        flags.append(f"keeps {share[0]:.2f} ± {share[1]:.2f} of the detail")
    return next(filter(None, flags), ""), square[0] < 0.8 * compared


def _constant(outcomes: list[Outcome]) -> bool:
    return all(float(np.ptp(o.arrays["range"])) == 0.0 for o in outcomes if o.arrays)


def _refusal(entry: Entry, spool: Spool) -> float:
    truth, bound = spool.truth(entry)
    return refusal_error(truth["range"], single_valued(truth["range"]), bound["range"])


_KEY = {
    "suite": "cheats", "scene": "wall", "stress": "none", "level": math.nan, "stress2": "none", "level2": math.nan, "seed": 1,
    "condition": "matched", "estimator": "cheat", "params": "",
}  # fmt: skip


def main(arguments: list[str]) -> int:
    """Print the table, and write it if a file is named."""
    only = arguments[arguments.index("--only") + 1 :] if "--only" in arguments else []
    files = arguments[: arguments.index("--only")] if only else arguments
    rows: list[list[str]] = []
    found: list[Verdict] = []
    print(isolation(), " | ".join(_COLUMNS), sep="\n", flush=True)
    for verdict in verdicts([cheat for cheat in CHEATS if not only or cheat.place.partition(":")[2] in only]):
        through = "yes" if verdict.got_through else ""
        rows.append([verdict.cheat, verdict.what, verdict.stopped_by, verdict.flagged_by, through])
        found.append(verdict)
        print(" | ".join(rows[-1]), flush=True)
    print(
        f"{len(found)} cheats: {sum(bool(v.stopped_by) for v in found)} stopped, "
        f"{sum(bool(v.flagged_by) for v in found)} flagged, {sum(v.got_through for v in found)} got through"
    )
    if files:
        with open(files[0], "w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([_COLUMNS, *rows])
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
