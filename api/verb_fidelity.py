"""`beambench fidelity`: every rung of the ladder on a family of scenes, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

__all__ = ["fidelity"]


def fidelity(
    *,
    scenes: int = 20,
    seed: int = 1,
    out: str | Path | None = None,
    overwrite: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Measure cost, error and task error of every rung on a seeded family of scenes; returns the folder that is written.

    Media (air, clear, coastal, harbour water), shapes (flat, corner, bowl, relief, mesh), near and far in turn; albedo,
    tilt, depth and beam are drawn. Errors are relative to full references at two independent seeds.

    Main arguments:
        scenes: how many; 40 hold every combination. seed: names the draws.
    Other arguments:
        out: folder; ./beambench-runs/fidelity-<time> by default. overwrite: replace the tables of an earlier measurement.
        progress: told one line per scene.

    Writes fidelity.csv, fidelity.json (shares within rtol, costs of policies) and fidelity.svg (cost against error).

    Raises:
        InputError: no scene, a negative seed, or results that exist already.
    """
    from .benchmarks.fidelity import run_fidelity
    from .scenes.errors import InputError

    if scenes < 1:
        raise InputError("At least one scene is needed.", where="scenes", value=scenes, allowed="1, 2, 3, …")
    if seed < 0:
        raise InputError("A seed is not negative.", where="seed", value=seed, allowed="0, 1, 2, …")
    if out is not None and not overwrite and (Path(out) / "fidelity.csv").exists():
        raise InputError(
            "This folder holds a measurement already.", where="--out", value=str(out), next_step="add --overwrite"
        )
    return run_fidelity(scenes, seed, out, progress)
