"""What a child is asked, and what became of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...captures.layouts import layout_of, stage_of
from ...captures.quantities import Stage

__all__ = ["Job", "Outcome"]


@dataclass(frozen=True)
class Job:
    """One capture under one condition for one estimator.

    `sizes`: lengths of the capture's dimensions. `timed`: False makes a single call without times and memory, which is
    cheaper if only the estimate is needed.
    """

    index: int
    folder: Path
    condition: str
    modality: str
    sizes: Mapping[str, int]
    timed: bool = True

    @property
    def elements(self) -> int:
        """Number of elements (pixels, shots, rows) of the capture."""
        return math.prod(self.sizes[dim] for dim in layout_of(self.modality).element)


@dataclass
class Outcome:
    """Result of a job. `status` is "ok", or begins with one of crash:, timeout:, memory:, flood:, error:, invalid:, skip:.

    `stage`: stage of the estimator; the modality's first if the estimator ended before it reported its stage.
    `cpu_s`, `wall_s`: medians over the timed calls, s; `cpu_calls`, `wall_calls`: the times of the single calls, s, the one whose
    answer is scored first.
    """

    job: Job
    status: str
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    cpu_s: float = float("nan")
    wall_s: float = float("nan")
    peak_bytes: float = float("nan")
    printed: str = ""
    cpu_calls: tuple[float, ...] = ()
    wall_calls: tuple[float, ...] = ()
    word: str = ""

    @property
    def stage(self) -> Stage:
        """The stage of the estimator; the first of the capture's modality if the estimator is of another modality."""
        first = layout_of(self.job.modality).stages[0]
        if not self.word:
            return first
        stage = stage_of(self.word)
        return stage if stage.modality == self.job.modality else first
