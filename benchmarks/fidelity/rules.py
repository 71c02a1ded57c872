"""Evaluation of three policies on the rows of a fidelity measurement: always `full`, always the cheapest rung, and `auto`.

The rules were fixed before any measurement. A rung passes a limit where the whole interval of its error is at or below it,
fails where the whole interval is above it, and is undecided otherwise. A scene and limit are *decided* where no rung is
undecided; then the right rung is the cheapest that passes, if any does. Shares are over the decided cases; the others are
counted in a column of their own. A policy is within the limit where the rung that it chooses passes, and at the cheapest
where that rung is the right one. Where no rung passes, no policy is within the limit. CPU times are sums over the decided
cases; that of `auto` includes the choice.

A rung passes against independent references ("pass") or agrees with our own `full` ("self-consistent"). The latter cannot see
a systematic error of `full`, so that the two are never counted together: each policy has a row for either kind of reference.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..statistics.rates import wilson_interval
from .bias import BIASES

__all__ = ["POLICIES", "POLICY_COLUMNS", "REFERENCES", "Decision", "decisions", "policy_rows", "summarise"]

#: Kinds of references: of other code, and two seeds of our own `full` rung.
REFERENCES = ("independent", "own")

POLICIES = ("always-full", "always-cheapest", "auto")
POLICY_COLUMNS = (
    "policy", "rtol", "decisions", "within_rtol", "lo", "hi", "cheapest", "cheapest_lo", "cheapest_hi", "cpu_s",
    "asking_cpu_s", "undecided", "none_passes", "reference",
)  # fmt: skip

#: From the cheapest to the most expensive.
_RUNGS = ("direct", "scatter", "full")
#: A decision is contested where the error of another rung is within this factor of the limit.
_NEAR = 3.0


@dataclass(frozen=True)
class Decision:
    """One scene at one limit: its rows by rung."""

    scene: str
    rtol: str
    rows: dict[str, dict[str, Any]]

    @property
    def decided(self) -> bool:
        """Whether no rung is undecided."""
        return all(row["verdict"] != "undecided" for row in self.rows.values())

    @property
    def reference(self) -> str:
        """ "independent" or "own": what the rungs were compared with."""
        return str(next(iter(self.rows.values()))["reference"])

    @property
    def right(self) -> str | None:
        """The cheapest rung that passes."""
        return next((r for r in _RUNGS if r in self.rows and _passes(self.rows[r])), None)

    def taken(self, policy: str) -> str:
        """The rung that a policy chooses."""
        if policy == "auto":
            return next(rung for rung, row in self.rows.items() if row["chosen"])
        return "full" if policy == "always-full" else "direct"

    @property
    def contested(self) -> bool:
        """Whether the error of a rung other than the right one is within a factor 3 of the limit."""
        limit = float(next(iter(self.rows.values()))["limit"])
        others = [row["rel_error"] for rung, row in self.rows.items() if rung != self.right]
        return any(limit / _NEAR <= error <= limit * _NEAR for error in others)


def decisions(rows: Iterable[dict[str, Any]]) -> list[Decision]:
    """Rows of fidelity.csv by scene and limit."""
    found: dict[tuple[str, str], dict[str, dict[str, Any]]] = {}
    for row in rows:
        found.setdefault((row["scene"], str(row["rtol"])), {})[row["rung"]] = row
    return [Decision(scene, rtol, by_rung) for (scene, rtol), by_rung in found.items()]


def policy_rows(every: Sequence[Decision]) -> list[dict[str, Any]]:
    """Rows of policies.csv: each policy at each limit, and over all fractions ("all": without "noise"), for each kind of
    reference."""
    rows = []
    for kind in REFERENCES:
        here = [d for d in every if d.reference == kind]
        if not here:
            continue
        groups = [("all", [d for d in here if d.rtol != "noise"])]
        groups += [(name, [d for d in here if d.rtol == name]) for name in dict.fromkeys(d.rtol for d in every)]
        rows += [_policy(policy, name, group, kind) for policy in POLICIES for name, group in groups]
    return rows


def _passes(row: dict[str, Any]) -> bool:
    return row["verdict"] in ("pass", "self-consistent")


def _policy(policy: str, rtol: str, group: Sequence[Decision], kind: str) -> dict[str, Any]:
    decided = [d for d in group if d.decided]
    n = len(decided)
    within = sum(_passes(d.rows[d.taken(policy)]) for d in decided)
    cheapest = sum(d.right is not None and d.taken(policy) == d.right for d in decided)
    asking = [float(next(iter(d.rows.values()))["choice_cpu_s"]) if policy == "auto" else 0.0 for d in decided]
    cpu = sum(asking) + sum(float(d.rows[d.taken(policy)]["cpu_s"]) for d in decided)
    low, high = wilson_interval(within, n)
    cheap_low, cheap_high = wilson_interval(cheapest, n)
    return {
        "policy": policy, "rtol": rtol, "decisions": n, "within_rtol": within / n if n else float("nan"), "lo": low, "hi": high,
        "cheapest": cheapest / n if n else float("nan"), "cheapest_lo": cheap_low, "cheapest_hi": cheap_high, "cpu_s": cpu,
        "asking_cpu_s": float(sum(asking)),
        "undecided": len(group) - n, "none_passes": sum(d.right is None for d in decided),
        "reference": kind,
    }  # fmt: skip


def summarise(rows: Sequence[dict[str, Any]], scenes: Sequence[dict[str, Any]] = ()) -> dict[str, Any]:
    """Content of fidelity.json: the right rungs and the number of contested decisions, predicted against measured errors,
    task errors of the choice of `auto` where the limit is the noise, and the references of every scene."""
    every = decisions(rows)
    fractions = [d for d in every if d.rtol != "noise"]
    decided = [d for d in fractions if d.decided]
    right = {rung: [d for d in decided if d.right == rung] for rung in _RUNGS}
    ratios = [
        abs(float(np.log10(row["predicted_error"] / row["rel_error"])))
        for d in fractions for rung, row in d.rows.items()
        if rung != "full" and row["rel_error"] > 1e-4 and row["predicted_error"] > 0
    ]  # fmt: skip
    noise = [d.rows[d.taken("auto")]["task_error"] for d in every if d.rtol == "noise"]
    return {
        "rule": "a rung passes where hi <= rtol, fails where lo > rtol; decided: no rung is undecided; by our own references a rung"
        " is self-consistent or not",
        "scenes": len({d.scene for d in every}),
        "scenes with independent references": len({d.scene for d in every if d.reference == "independent"}),
        "decisions": len(fractions),
        "decided": len(decided),
        "undecided": len(fractions) - len(decided),
        "decided scenes": len({d.scene for d in decided}),
        "no rung passes": sum(d.right is None for d in decided),
        "right rung": {rung: len(found) for rung, found in right.items()},
        "right rung, scenes": {rung: len({d.scene for d in found}) for rung, found in right.items()},
        "contested": {rung: sum(d.contested for d in found) for rung, found in right.items()},
        "median |log10 predicted/measured|": float(np.median(ratios)) if ratios else None,
        "task error at rtol noise": {
            "decisions": len(noise), "below 0.1": sum(t < 0.1 for t in noise),
            "median": float(np.median(noise)) if noise else None, "largest": max(noise, default=None),
        },
        "policies": [{name: None if value != value else value for name, value in row.items()} for row in policy_rows(every)],
        "bias of full that would have been seen": _seen(scenes),
        "references": list(scenes),
    }  # fmt: skip


def _seen(scenes: Sequence[dict[str, Any]]) -> dict[str, int]:
    """In how many scenes a bias of `full` of this size would have been found; the rest are self-consistent at best."""
    known = [one.get("bias_seen") for one in scenes]
    found = {f"{bias:.0%}": sum(seen is not None and seen <= bias for seen in known) for bias in BIASES}
    return found | {"none": sum(seen is None for seen in known)}
