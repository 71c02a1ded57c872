"""The captures of a run and what estimators make of them: generated, stored, handed to children, scored, kept in the journal."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..estimators.chain import is_built_in
from ..scenes.errors import InputError
from .ahead import Ahead
from .folders.journal import Journal, with_nan, without_nan
from .folders.progress import Progress
from .folders.record import machine
from .judges.mismatch import wrongly_declared
from .report.as_measured import as_measured
from .report.picture_files import Place, picture_index, write_picture
from .rungs import Rungs
from .runner.costs import cost_row
from .runner.estimator_labels import Chosen
from .runner.forked import Prepared
from .runner.protocol import content_id
from .runner.result_cache import ResultCache
from .runner.session import Job, Outcome, Session, run_sessions
from .runner.spool import Entry, Spool
from .scores.error_tiles import TileKey, main_tiles
from .scores.inputs import input_rows
from .scores.resolution import resolution_rows
from .scores.score import score_rows
from .scores.slips import slips_of
from .scores.truth import Truth, aligned, errors_of
from .statistics.skips import not_applicable, skipped_rows
from .suites.declared import told_condition
from .suites.suite import Cell, Loaded, cell_name

if TYPE_CHECKING:
    import xarray as xr

    from .judges.calibrate import Calibrations

__all__ = ["Measuring"]


def _name(cell: Cell) -> str:
    return cell_name(cell.scene_name, ((cell.stress, cell.level), (cell.stress2, cell.level2)), cell.seed)


class Measuring:
    """The state of one run."""

    def __init__(
        self,
        loaded: Loaded,
        chosen: list[Chosen],
        folder: Path,
        journal: Journal,
        progress: Progress,
        cells: list[Cell],
        cache: ResultCache | None = None,
    ) -> None:
        self.cache = cache
        self.loaded, self.suite, self.chosen = loaded, loaded.suite, chosen
        self.folder, self.progress = folder, progress
        self.journal = journal
        for part in ("captures", "pictures"):
            (folder / part).mkdir(exist_ok=True)
        # By the scene as the suite names it: stresses do not change the name of a condition.
        self._tells: dict[str, dict[str, str]] = {
            name: {one: told_condition(one, scene) for one in loaded.conditions(name)} for name, scene in loaded.scenes
        }
        self.rows: list[dict[str, Any]] = []
        self.costs: list[dict[str, Any]] = []
        self.resolution: list[dict[str, Any]] = []
        self.slips: list[dict[str, Any]] = []
        self.tiles: dict[TileKey, tuple[Any, Any]] = {}
        self.inputs: list[dict[str, Any]] = []
        #: Forks the processes of built-in estimators, and compiles for them, while a run has both.
        self.prepared: Prepared | None = None
        self.ahead: Ahead | None = None
        self._device = str(machine()["device_class"])
        self.warnings: list[str] = []
        self.rungs = Rungs(loaded.suite.suite, loaded.own_rungs())
        self.failures: list[dict[str, str]] = []
        self.stages = dict.fromkeys(("generate", "store", "bound", "calibrate", "estimate"), 0.0)
        #: The estimators that read a scene, by its name.
        self._readers = {
            name: frozenset(
                one.label for one, label in zip(chosen, self.suite.estimators, strict=True) if loaded.reads(label, name)
            )
            for name, _ in loaded.scenes
        }
        self.total = sum(
            len(self._readers[name]) * len(loaded.conditions(name)) for name in (c.scene_name for c in cells)
        )
        self.done = 0
        self._calibrations: Calibrations | None = None

    def _timed(self, stage: str, call: Callable[[], Any]) -> Any:
        tick = time.perf_counter()
        result = call()
        self.stages[stage] += time.perf_counter() - tick
        return result

    def rounded_stages(self) -> dict[str, float]:
        """Wall time of each stage, to a millisecond, s."""
        return {name: round(value, 3) for name, value in self.stages.items()}

    def spool_cell(self, spool: Spool, index: int, cell: Cell) -> Entry:
        """Generate a capture, or read it when resuming; store it, and write it for the child processes."""
        from .judges.bound import bounds_of, truths_of
        from .judges.drawn import with_draws

        capture = self._capture(cell)
        self.rungs.add(cell, capture)
        bounds = with_draws(
            self._timed("bound", lambda: bounds_of(capture)), capture, self.loaded.draws(cell.scene_name)
        )
        entry = spool.add(index, cell, capture, self._conditions(cell, capture), truths_of(capture), bounds)
        self.inputs += input_rows(
            cell,
            {self._told(cell, name): content_id(entry.sums, name) for name in self.loaded.conditions(cell.scene_name)},
        )
        return entry

    def _told(self, cell: Cell, condition: str) -> str:
        """The name of a condition in tables."""
        return self._tells[cell.scene_name][condition]

    def _store(self, cell: Cell) -> Path:
        return self.folder / "captures" / f"{_name(cell)}.zarr"

    def _capture(self, cell: Cell) -> xr.Dataset:
        from ..captures import open_captures, write
        from ..captures.store.publish import partial_of
        from ..generator.generate import generate

        path = self._store(cell)
        if path.exists():  # when resuming: a store under its final name is complete, and checked on reading
            return open_captures(path)[0]
        fidelity: Any = cell.fidelity
        shutil.rmtree(partial_of(path), ignore_errors=True)  # left by an interrupted run
        capture = self._timed(
            "generate",
            lambda: generate(
                cell.scene, seed=cell.random_seed, capture_key=cell.key, fidelity=fidelity, rtol=self.suite.rtol
            ),
        )
        self._timed("store", lambda: write(path, capture))
        return capture  # type: ignore[no-any-return]

    def _conditions(self, cell: Cell, capture: xr.Dataset) -> dict[str, Callable[[xr.Dataset], xr.Dataset]]:
        return {name: self._condition(name, cell, capture) for name in self.loaded.conditions(cell.scene_name)}

    def _condition(self, name: str, cell: Cell, capture: xr.Dataset) -> Callable[[xr.Dataset], xr.Dataset]:
        if name == "matched":
            return lambda hidden: hidden
        if name == "mismatched":
            return partial(wrongly_declared, cell.scene, self.suite.mismatch)
        if self._calibrations is None:
            from .judges.calibrate import Calibrations

            assert self.suite.calibration is not None
            self._calibrations = Calibrations(self.suite.calibration)
        calibrations = self._calibrations
        rig = self._timed("calibrate", lambda: calibrations.declared(cell, str(capture.attrs["rig"])))
        return lambda hidden: hidden.assign_attrs(rig=rig)

    def estimate(self, spool: Spool, batch: list[Entry]) -> None:
        """Run every estimator on the spooled captures, score the results, and delete the captures."""
        tick = time.perf_counter()
        entries = {entry.index: entry for entry in batch}
        # A child of its own for each condition, which cannot remember the exact rig of another.
        asked = [(chosen, condition) for chosen in self.chosen for condition in self.suite.conditions]
        sessions = [
            Session(
                chosen.label,
                self._jobs(spool, batch, chosen, condition),
                self.suite.limits,
                spool.open / f"estimator-{number}",
                hidden=(self.folder, spool.closed),
                fresh_child=self.suite.new_child == "capture" and not is_built_in(chosen.name),
                prepared=self.prepared,
            )
            for number, (chosen, condition) in enumerate(asked)
        ]
        self.progress("estimate", self.done, self.total, "starting")
        run_sessions(
            sessions,
            lambda n, outcome: self._take(spool, entries[outcome.job.index], asked[n][0], outcome),
            before_timed=self.ahead.stop if self.ahead is not None else None,
        )
        for entry in batch:
            spool.drop(entry)
        if self.cache is not None:
            self.cache.prune()
        self.stages["estimate"] += time.perf_counter() - tick

    def _jobs(self, spool: Spool, batch: list[Entry], chosen: Chosen, condition: str) -> list[Job]:
        """The captures that an estimator still has to read. Results in the journal or the cache become rows at once."""
        jobs: list[Job] = []
        for entry in batch:
            name = entry.cell.scene_name
            if chosen.label not in self._readers[name] or condition not in self.loaded.conditions(name):
                continue
            key = self._journal_key(entry, condition, chosen)
            finished = self.journal.done.get(key)
            if finished is not None:
                self._keep(entry, condition, chosen, finished, self.journal.beside[key])
                self.done += 1
                continue
            job = Job(entry.index, entry.folder, condition, entry.modality, entry.sizes)
            kept = self.cache.get(job, chosen) if self.cache is not None else None
            if kept is not None:
                self._take(spool, entry, chosen, kept, fresh=False)
            else:
                jobs.append(job)
        return jobs

    @staticmethod
    def _journal_key(entry: Entry, condition: str, chosen: Chosen) -> tuple[str, ...]:
        cell = entry.cell
        axes = (cell.scene_name, cell.stress, repr(cell.level), cell.stress2, repr(cell.level2), str(cell.seed))
        return (*axes, condition, chosen.label)

    def _take(self, spool: Spool, entry: Entry, chosen: Chosen, outcome: Outcome, *, fresh: bool = True) -> None:
        cell, job = entry.cell, outcome.job
        truth, bound = spool.truth(entry)
        if not spool.intact(entry):
            outcome.status = "invalid: changed its input"
            self._restore(spool, entry)
        if fresh and self.cache is not None:
            self.cache.put(outcome, chosen)
        key = {
            "suite": self.suite.suite, "scene": cell.scene_name, "stress": cell.stress, "level": cell.level,
            "stress2": cell.stress2, "level2": cell.level2, "seed": cell.seed, "condition": self._told(cell, job.condition),
            "estimator": chosen.name, "params": chosen.params,
        }  # fmt: skip
        rows = score_rows(
            key, outcome.stage, truth, bound, outcome.arrays or None, status=outcome.status, cpu_s=outcome.cpu_s,
            wall_s=outcome.wall_s, peak_bytes=outcome.peak_bytes, failure_at=self.suite.failure_at,
        )  # fmt: skip
        rows = skipped_rows(rows)
        beside: dict[str, Any] = {}
        if not not_applicable(outcome.status):
            cost = cost_row(key, outcome, device_class=self._device, source="measured" if fresh else "cache")
            beside["cost"] = without_nan(cost)
            if outcome.status == "ok":
                beside["resolution"] = [
                    without_nan(row) for row in resolution_rows(key, outcome.stage, outcome.arrays, truth)
                ]
                if slips := slips_of(outcome.stage, outcome.arrays, truth):
                    names = {"estimator": chosen.name, "params": chosen.params}
                    beside["slips"] = [without_nan(names | row) for row in slips]
            if cell.level != cell.level:
                beside["tiles"] = main_tiles(
                    outcome.stage, outcome.arrays if outcome.status == "ok" else {}, truth, bound
                )
        self._keep(entry, job.condition, chosen, rows, beside)
        self.journal.add(self._journal_key(entry, job.condition, chosen), rows, **beside)
        if outcome.status.startswith("skip:"):
            pass  # reported once per estimator and reason, in `skipped`
        elif outcome.status != "ok":
            message = outcome.status + (f"\n{outcome.printed}" if outcome.printed.strip() else "")
            self.failures.append({
                "estimator": chosen.label, "scene": cell.scene_name, "condition": self._told(cell, job.condition),
                "message": message,
            })  # fmt: skip
        elif self._shown(cell, job.condition):
            self._draw(cell, chosen, outcome, truth)
        self.done += 1
        self.progress("estimate", self.done, self.total, as_measured(chosen.label, rows))

    def _draw(self, cell: Cell, chosen: Chosen, outcome: Outcome, truths: Mapping[str, Truth]) -> None:
        """Store the picture of an estimate for the page, if its stage gives one."""
        found = (
            (q, index) for q in outcome.stage.gives if (index := picture_index(q)) is not None and q.name in truths
        )
        quantity, index = next(found, (None, None))
        if quantity is None or index is None:
            return
        truth = truths[quantity.name]
        value, _, valid = aligned(outcome.arrays, outcome.stage, quantity, truth.value.shape)
        place = Place(cell.scene_name, chosen.label, self._told(cell, outcome.job.condition))
        images = [array[index] for array in (value, valid, truth.value, errors_of(value, truth))]
        write_picture(self.folder / "pictures", place, quantity, *images)

    def _keep(
        self, entry: Entry, condition: str, chosen: Chosen, rows: list[dict[str, Any]], beside: dict[str, Any]
    ) -> None:
        """Add the rows of one estimate, its cost and its errors by tile to those of the run."""
        self.rows += rows
        if "cost" in beside:
            self.costs.append(with_nan(beside["cost"]))
        self.resolution += [with_nan(row) for row in beside.get("resolution", ())]
        self.slips += [with_nan(row) for row in beside.get("slips", ())]
        if "tiles" in beside:
            sums, counts = beside["tiles"]
            self.tiles[entry.cell.scene_name, self._told(entry.cell, condition), entry.cell.seed, chosen.label] = (
                sums,
                counts,
            )

    def _shown(self, cell: Cell, condition: str) -> bool:
        """Whether the page shows a cell: unchanged scenes, first seed, first condition."""
        if cell.secret is not None:  # a picture of the truth would tell it
            return False
        as_written = cell.level != cell.level and cell.seed == _first_seed(self.loaded, cell)
        return as_written and condition == self.suite.conditions[0]

    def _restore(self, spool: Spool, entry: Entry) -> None:
        from ..captures import open_captures

        capture = open_captures(self._store(entry.cell))[0]
        truth, bound = spool.truth(entry)
        spool.drop(entry)
        spool.add(entry.index, entry.cell, capture, self._conditions(entry.cell, capture), truth, bound)


def _first_seed(loaded: Loaded, cell: Cell) -> int:
    """The seed whose pictures are stored: the first one of the split of the cell."""
    for seeds in (loaded.suite.seeds.test, loaded.suite.seeds.dev):
        if cell.seed in seeds:
            return int(seeds[0])
    raise InputError("A cell has a seed that the suite does not contain.", where="seeds", value=cell.seed)
