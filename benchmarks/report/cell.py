"""A cell of the report: all seeds of one estimator in one scene, stress and condition."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ...captures.layouts import LAYOUTS, layout_of
from ..statistics.skips import not_applicable
from ..statistics.suspects import suspicion

__all__ = ["FAILS_ABOVE", "Cell", "common_noun"]

#: Above this share of failed elements an estimator counts as failing in a cell (`level10` of breakdown.csv).
FAILS_ABOVE = 0.10


@dataclass
class Cell:
    """All seeds of one estimator in one scene, stress and condition. Lengths in the column `unit`, times in seconds."""

    scene: str
    stress: str
    level: str
    stress2: str
    level2: str
    condition: str
    modality: str
    stage: str
    quantity: str
    unit: str
    label: str
    seeds: int
    n: float
    coverage: float
    failure_rate: float
    bias: float
    rmse: float
    rmse_full: float
    p95: float
    bound: float
    bound_kind: str
    efficiency: float
    efficiency_lo: float
    efficiency_hi: float
    z_rms: float
    cover95: float
    cpu_s: float
    cpu_per_element_s: float
    throughput: float
    peak_bytes: float
    status: str
    #: The statuses of the pooled rows, each once.
    statuses: tuple[str, ...] = ()
    #: (seed, n, rmse_full, cpu_s) of each pooled row.
    per_seed: tuple[tuple[int, float, float, float], ...] = ()
    #: In its panel: "front", "dominated", "undecided", or "" where it is not drawn; see `front.py`.
    verdict: str = ""
    #: No other point of the panel has both smaller error and smaller cost, intervals disregarded.
    front: bool = False
    cpu_lo: float = math.nan
    cpu_hi: float = math.nan
    error_lo: float = math.nan
    error_hi: float = math.nan

    @property
    def ok(self) -> bool:
        """True where the estimator finished on every seed."""
        return self.status == "ok"

    @property
    def stressed(self) -> bool:
        """True where a stress was applied."""
        return bool(self.stress)

    @property
    def mixed(self) -> bool:
        """True for mixed elements (with several ranges), which are scored separately."""
        return self.quantity.endswith("-mixed")

    @property
    def skipped(self) -> bool:
        """True where the estimator does not apply: another modality, or a package that is not installed."""
        return not_applicable(self.status)

    @property
    def fails(self) -> bool:
        """True where it applies but did not run, or failed on more than a tenth of the elements."""
        return not self.skipped and (not self.ok or self.failure_rate > FAILS_ABOVE)

    @property
    def suspect(self) -> str:
        """Why the result is not ranked (no error at all, or beyond its bound by more than chance), or ""."""
        answered = self.n * self.coverage
        return suspicion(self.rmse, self.bound, answered, self.bound_kind) if self.ok and answered > 0 else ""

    @property
    def noun(self) -> str:
        """Name of an element of the quantity, which CPU times and failures are counted by, e.g. pixel, shot or spot."""
        if self.modality not in LAYOUTS:
            return "element"
        layout, name = layout_of(self.modality), self.quantity.removesuffix("-mixed")
        return next((q.noun for q in layout.quantities if q.name == name), "") or layout.noun

    @property
    def place(self) -> str:
        """Text for the cell: scene, condition and stress."""
        where = f"{self.scene}, {self.condition}" if self.condition else self.scene
        for axis, level in ((self.stress, self.level), (self.stress2, self.level2)):
            if axis:
                where += f", {axis} {level}"
        return f"{where}, mixed {self.noun}s" if self.mixed else where


def common_noun(cells: Iterable[Cell]) -> str:
    """The word for an element that all cells share, else "element"."""
    nouns = {cell.noun for cell in cells}
    return nouns.pop() if len(nouns) == 1 else "element"
