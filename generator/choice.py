"""The choice of a rung by its predicted error, and how the permitted error is shared out within a rung."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

__all__ = ["RUNG_SHARE", "Choice", "Rtol", "Rung", "chosen"]

Rtol = float | Literal["noise"]
Rung = Literal["direct", "scatter", "full", "geometric", "isolated", "coherent"]

#: Share of the limit that a rung's sampling may take: what it leaves out adds to it. The full rung leaves out nothing, and
#: shares its rtol between rays and paths itself.
RUNG_SHARE: dict[str, float] = {
    "direct": 0.3, "scatter": 0.3, "full": 1.0, "geometric": 1.0, "isolated": 1.0, "coherent": 1.0,
}  # fmt: skip
#: Share of `Choice.rtol` that the rung is rendered to, so that it and what the rung leaves out stay below rtol together.
_RENDERED_SHARE: dict[str, float] = {
    "direct": 0.5, "scatter": 0.5, "full": 1.0, "geometric": 1.0, "isolated": 1.0, "coherent": 1.0,
}  # fmt: skip


@dataclass(frozen=True)
class Choice:
    """A rung and the reasons for it.

    Main arguments:
        rung: the cheapest whose predicted error passes. rtol: what the rung and all that it leaves out are to stay below.
        predicted: error of every rung that was considered, relative to the expectation.
        limit: what these errors were compared with. basis: how they were predicted.
        sizes: predicted relative size of effects by their names in the catalogue.
        sampled: the limit that the rung's sampling goes by.
    Other arguments:
        task: predicted task errors in units of the bound, where the limit is the noise.
        supersedes: whether `sizes` are better than those of the catalogue of effects, and replace them.
    """

    rung: Rung
    rtol: float
    predicted: dict[str, float]
    limit: float
    basis: str
    sizes: dict[str, float]
    sampled: float
    task: dict[str, float] = field(default_factory=dict)
    supersedes: bool = True

    @property
    def rendered(self) -> float:
        """Relative error that the rung is rendered to."""
        return self.rtol * _RENDERED_SHARE[self.rung]

    def record(self) -> dict[str, Any]:
        """What the capture keeps of the choice."""
        kept = {"predicted_error": self.predicted, "limit": self.limit, "basis": self.basis}
        return kept | ({"predicted_task_error": self.task} if self.task else {})


def chosen(
    rung: Rung,
    predicted: dict[str, float],
    limit: float,
    sampled: float,
    basis: str,
    sizes: dict[str, float],
    task: dict[str, float] | None = None,
    *,
    supersedes: bool = True,
) -> Choice:
    """A `Choice` whose rtol follows from `sampled` and the rung's share of it, within 1e-6 … 0.5."""
    rtol = sampled * RUNG_SHARE[rung] / _RENDERED_SHARE[rung]
    return Choice(rung, min(max(rtol, 1e-6), 0.5), predicted, limit, basis, sizes, sampled, task or {}, supersedes)
