"""`beambench fidelity`: cost and error of every rung of the generator, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

__all__ = ["fidelity"]


def fidelity(
    *,
    scenes: int = 60,
    seed: int = 1,
    modality: str | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Measure the cost and the error of each rung of the generator, and whether fidelity "auto" chooses well.

    The scenes are drawn at random: media (air, faint, clear, coastal and harbour water), shapes (flat, corner, bowl, relief,
    mesh), near and far; albedo, water, tilt, depth and beam vary so that the limits between rungs are crossed. Errors
    are relative to two independent references: mitransient and ours where the noise of mitransient allows, else two
    of ours. The limits are 10, 3 and 1 % of the expected counts, and the noise of the detector.

    Main arguments:
        scenes: Number of scenes.
        seed: Random seed of the scenes.
        modality: Whose rungs to measure, on its own family of scenes; the family above by default.
    Other arguments:
        out: Folder of the results; ./beambench-runs/fidelity-<time> by default.
        overwrite: Replace an earlier measurement, once the new one is complete.
        resume: Continue an interrupted measurement in `out` after its last complete scene.
        progress: Receives one line per scene.

    Returns:
        The folder, with fidelity.csv (a row per scene, rung and limit), policies.csv (share within the limit and cost of
        always the fullest rung, always the cheapest, and auto), fidelity.json (the rule, correct rungs, references of
        every scene) and fidelity.svg.

    Raises:
        InputError: No scene, a negative seed, an output that exists, a modality without such a
            family, or a measurement with another seed to continue.
    """
    from ..benchmarks.fidelity.run import run_fidelity
    from ..scenes.errors import InputError

    if scenes < 1:
        raise InputError("At least one scene is needed.", where="scenes", value=scenes, allowed="1, 2, 3, …")
    if seed < 0:
        raise InputError("A random seed is not negative.", where="seed", value=seed, allowed="0, 1, 2, …")
    bench = None
    if modality is not None:
        from ..benchmarks.fidelity.bench import bench_of

        bench = bench_of(modality)
    return run_fidelity(scenes, seed, out, progress, resume=resume, overwrite=overwrite, bench=bench)
