"""`beambench fidelity`: every rung of the ladder on a family of scenes, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

__all__ = ["fidelity"]


def fidelity(
    *,
    scenes: int = 60,
    seed: int = 1,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Measure cost, error and task error of every rung on a seeded family of scenes; returns the folder that is written.

    Media (air, faint, clear, coastal, harbour water), shapes (flat, corner, bowl, relief, mesh), near and far; albedo, water,
    tilt, depth and beam are drawn so that the borders between rungs are met. Errors are relative to two independent
    references: mitransient's and ours where mitransient's noise allows, else two of ours. Limits: 10, 3 and 1 % of
    the stack, and the detector's noise.

    Main arguments:
        scenes: how many. seed: names the draws.
    Other arguments:
        out: folder; ./beambench-runs/fidelity-<time> by default. overwrite: replace an earlier measurement, once the
            new one is complete.
        resume: go on with one that was interrupted. progress: told one line per scene.

    Writes fidelity.csv (a row for each scene, rung and limit), policies.csv (shares within the limit and cost of always-full,
    always-cheapest and auto), fidelity.json (the rule, right rungs, references of every scene) and fidelity.svg.

    Raises:
        InputError: no scene, a negative seed, an output that exists, or to resume a measurement of another seed.
    """
    from ..benchmarks.fidelity.run import run_fidelity
    from ..scenes.errors import InputError

    if scenes < 1:
        raise InputError("At least one scene is needed.", where="scenes", value=scenes, allowed="1, 2, 3, …")
    if seed < 0:
        raise InputError("A seed is not negative.", where="seed", value=seed, allowed="0, 1, 2, …")
    return run_fidelity(scenes, seed, out, progress, resume=resume, overwrite=overwrite)
