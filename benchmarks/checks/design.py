"""Does a design do what its bound says? Monte Carlo of maximum likelihood under the scene's own delays and the chosen ones.

    python -m beambench.benchmarks.checks.design [--seeds N] [--budget B] [--widths 1,2] [--fidelity RUNG] [SCENE …]

Each scene is generated with its own delays and with the chosen ones, for equally many pulses in all, and read by `poisson-ml`.
Columns: rms error over all pixels that see one surface (a pixel without an answer counts with the error of the prior), their ratio
with its 95 % interval by bootstrap over seeds and blocks of 8 × 8 pixels, and the ratio of the bounds for which the delays were
chosen. `even` is a rival of equal pulses too: as many slices as the chosen design and its gate, evenly over the span of the
scene's own delays.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...scenes.load import load_scene
from ...scenes.scene import Scene
from ..design.kind import Option
from ..design.run import designed
from ..judges.bound import cramer_rao_bound, truth_of
from ..scores.truth import single_valued

__all__ = ["Compared", "compared", "squares"]

Float = npt.NDArray[np.float64]

_SCENES = ("flat-wall", "harbour-wall", "tilted-wall")
#: Reads a stack; side of a block of pixels that the bootstrap keeps together; its draws.
_READER, _BLOCK, _DRAWS = "poisson-ml", 8, 2000


@dataclass(frozen=True)
class Compared:
    """Rms errors [m] of the scene's own design, the chosen one and an even one; ratio own/chosen with its interval; that of the
    bounds; shares of answers."""

    own_m: float
    chosen_m: float
    even_m: float
    ratio: float
    low: float
    high: float
    predicted: float
    answered: tuple[float, float]
    name: str


def squares(
    scene: Scene, overrides: Mapping[str, Any], seeds: Sequence[int], fidelity: Any = None
) -> tuple[Float, float]:
    """(sums of squared errors and counts (seed·block, 2) [m²], share of answers) of a scene under a design."""
    from ...generator.generate import generate

    held = load_scene(scene, overrides)
    sums: list[Float] = []
    answered = []
    for seed in seeds:
        capture = generate(held, seed=seed, fidelity=fidelity)
        truth = truth_of(capture)
        found = run_estimator(_READER, hide_truth(capture))
        good = single_valued(truth)
        valid = found["valid"].values & good
        error = np.where(valid, found["range"].values - truth.value, cramer_rao_bound(capture).prior)
        answered.append(valid.sum() / good.sum())
        rows, cols = (np.arange(size) // _BLOCK for size in truth.value.shape)
        block = (rows[:, None] * (cols.max() + 1) + cols).ravel()
        square = np.where(good, error, 0.0).ravel() ** 2
        sums.append(np.stack([np.bincount(block, square), np.bincount(block, good.ravel().astype(float))], axis=1))
    return np.concatenate(sums), float(np.mean(answered))


def _rms(sums: Float) -> float:
    return float(np.sqrt(sums[:, 0].sum() / sums[:, 1].sum()))


def _even(best: Option, scene: Scene) -> dict[str, Any]:
    """The chosen design with its slices evenly over the span of the scene's own delays."""
    own = scene.rig.delays.settings_s  # type: ignore[attr-defined]
    values = np.linspace(own.min(), own.max(), len(best.overrides["rig.delays"]["values_s"]))
    return {**best.overrides, "rig.delays": {"kind": "listed", "values_s": values.tolist()}}


def _width(scene: Scene) -> float:
    gate = scene.rig.gates[0]  # type: ignore[attr-defined]
    return float(getattr(gate, "width_s", None) or gate.fwhm_s)


def compared(
    name: str, *, seeds: Sequence[int], budget: float = 1.0, widths: Sequence[float] = (1.0, 2.0), fidelity: Any = None
) -> Compared:
    """The comparison for one scene of the library, by name. widths: of gates to choose from, as multiples of the scene's own.
    fidelity: rung of the light that is designed for and read; the cheapest by default."""
    scene = load_scene(name)
    width = _width(scene)
    allow = ("slices=6,8", "gate-width=" + ",".join(str(width * one) for one in widths))
    found = designed(scene, budget=budget, allow=allow, fidelity=fidelity)
    pulses = max(round(scene.rig.pulses_per_slice * budget), 1)  # type: ignore[attr-defined]
    own, answered = squares(scene, {"rig.pulses_per_slice": pulses}, seeds, fidelity)
    chosen, also = squares(scene, found.best.overrides, seeds, fidelity)
    even, _ = squares(scene, _even(found.best, scene), seeds[:1], fidelity)
    rng = np.random.default_rng(5)
    draws = []
    for _ in range(_DRAWS):
        one, two = (sums[rng.integers(len(sums), size=len(sums))] for sums in (own, chosen))
        draws.append(_rms(one) / _rms(two))
    low, high = np.quantile(draws, [0.025, 0.975])
    return Compared(
        _rms(own), _rms(chosen), _rms(even), _rms(own) / _rms(chosen), float(low), float(high), found.gain,
        (answered, also), found.best.name,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=_SCENES)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--budget", type=float, default=1.0)
    parser.add_argument("--widths", default="1,2")
    parser.add_argument("--fidelity", default=None)
    given = parser.parse_args(arguments)
    widths = [float(one) for one in given.widths.split(",")]
    print("scene            own [mm]  chosen [mm]  even [mm]  own/chosen  95 % interval   by bounds  design")
    reached = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in given.scenes:
            seeds = range(101, 101 + given.seeds)
            one = compared(name, seeds=seeds, budget=given.budget, widths=widths, fidelity=given.fidelity)
            reached += one.ratio >= 2.0
            print(
                f"{name:15s} {1e3 * one.own_m:9.3f} {1e3 * one.chosen_m:12.3f} {1e3 * one.even_m:10.3f} {one.ratio:11.2f}"
                f"  {one.low:.2f} … {one.high:.2f} {one.predicted:14.2f}  {one.name}; answered {one.answered[0]:.3f}, "
                f"{one.answered[1]:.3f}",
                flush=True,
            )
    print(f"{reached} of {len(given.scenes)} scenes gain a factor of 2 or more")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
