"""Does a design do what its bound says? Monte Carlo of maximum likelihood under the scene's own design and the chosen one.

    python -m beambench.benchmarks.checks.design [--seeds N] [--budget B] [--widths 1,2] [--slices 6,8] [--model direct|exact]
                                                 [--fidelity RUNG] [SCENE …]

Each scene is generated with its own design and with the chosen one, for equally much light in all, and read: a stack of gated
images by `poisson-ml`, a laser line by `line-ml` and `triangulate-refractive`, a wavefront sensor by `spot-ml`, `slope-cell` and
`zernike-map`. Columns: rms error over all elements of one true value (without an answer, that of the prior, where there
is one), their ratio with its 95 % interval by bootstrap over seeds and blocks (8 × 8 pixels; 8 rows of a line; a whole
wavefront), and the ratio of the errors for which the design was chosen. `even` is a rival of equal pulses too: as many slices as
the chosen design and its gate, evenly over the span of the scene's own delays.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.hide import hide_truth
from ...estimators import run_estimator
from ...estimators.registry import get_estimator
from ...scenes.load import load_scene
from ...scenes.scene import Scene
from ..design.kind import Option
from ..design.run import designed, designs_of
from ..judges.bound import bounds_of, truths_of
from ..scores.truth import aligned, single_valued

__all__ = ["Compared", "compared", "squares"]

Float = npt.NDArray[np.float64]

_SCENES = ("flat-wall", "harbour-wall", "tilted-wall", "object1", "spotscan-wall", "gated-turbulence")
#: What reads a quantity, and how many neighbours of each dimension the bootstrap keeps together; 0: all.
_READERS = {
    "range": ("poisson-ml", (8, 8)), "point": ("line-ml+triangulate-refractive", (1, 8, 0, 0)),
    "phase": ("spot-ml+slope-cell+zernike-map", (1, 0, 0)),
}  # fmt: skip
_DRAWS = 2000


@dataclass(frozen=True)
class Compared:
    """Rms errors [m, or rad] of the scene's own design, the chosen one and an even one (NaN: none); ratio own/chosen with its
    interval; that of the predictions; shares of answers."""

    own: float
    chosen: float
    even: float
    ratio: float
    low: float
    high: float
    predicted: float
    answered: tuple[float, float]
    name: str
    shown: tuple[float, str]


def squares(
    scene: Scene, overrides: Mapping[str, Any], seeds: Sequence[int], fidelity: Any = None, quantity: str = "range"
) -> tuple[Float, float]:
    """(sums of squared errors and counts (seed·block, 2), share of answers) of a scene under a design."""
    from ...generator.generate import generate

    held = load_scene(scene, overrides)
    sums: list[Float] = []
    answered = []
    for seed in seeds:
        capture = generate(held, seed=seed, fidelity=fidelity)
        square, good, share = _read(capture, quantity)
        block = _blocks(square.shape, _READERS[quantity][1])
        sums.append(np.stack([np.bincount(block, one.ravel()) for one in (square, good.astype(float))], axis=1))
        answered.append(share)
    return np.concatenate(sums), float(np.mean(answered))


def _read(capture: xr.Dataset, quantity: str) -> tuple[Float, npt.NDArray[np.bool_], float]:
    """(squared errors, which elements count, share of them with an answer) of a quantity, in the shape of its truth."""
    label = _READERS[quantity][0]
    stage = get_estimator(label).stage
    found = run_estimator(label, hide_truth(capture))
    truth = truths_of(capture)[quantity]
    arrays = {str(name): one.values for name, one in found.variables.items()}
    which = next(one for one in stage.gives if one.name == quantity)
    value, _, valid = aligned(arrays, stage, which, truth.value.shape)
    good = single_valued(truth)
    valid = valid & good & np.isfinite(value)
    prior = bounds_of(capture)[quantity].prior
    counted = good if math.isfinite(prior) else valid
    error = np.where(valid, value - np.where(good, truth.value, 0.0), prior if math.isfinite(prior) else 0.0)
    return np.where(counted, error, 0.0) ** 2, counted, float(valid.sum() / max(good.sum(), 1))


def _blocks(shape: tuple[int, ...], sizes: Sequence[int]) -> npt.NDArray[np.intp]:
    """Number of the block of every element, flat."""
    total, number = 1, np.zeros(shape, np.intp)
    for axis, (count, size) in enumerate(zip(shape, sizes, strict=True)):
        place = np.arange(count) // (size or count)
        number += total * place.reshape([-1 if k == axis else 1 for k in range(len(shape))])
        total *= int(place[-1]) + 1
    return number.ravel()


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
    name: str, *, seeds: Sequence[int], budget: float = 1.0, widths: Sequence[float] = (1.0, 2.0), slices: str = "6,8",
    fidelity: Any = None, model: str | None = None, overrides: Mapping[str, Any] | None = None, allow: Sequence[str] = (),
) -> Compared:  # fmt: skip
    """The comparison for one scene of the library, by name.

    Other arguments:
        widths, slices: of gates to choose from, as multiples of the scene's own, and their numbers; of stacks of gated images.
        fidelity: rung of the light that is designed for and read; the cheapest by default. model: as `designed` takes it.
        overrides: of the scene. allow: settings to choose from, where there is no stack.
    """
    scene = load_scene(name, overrides)
    quantity, stack = designs_of(scene).quantity, hasattr(scene.rig, "gates") and hasattr(scene.rig, "pulses_per_slice")
    held: dict[str, Any] = {}
    if stack:
        width = _width(scene)
        allow = (f"slices={slices}", "gate-width=" + ",".join(str(width * one) for one in widths))
        held = {"rig.pulses_per_slice": max(round(float(getattr(scene.rig, "pulses_per_slice")) * budget), 1)}  # noqa: B009
    found = designed(scene, budget=budget, allow=allow, fidelity=fidelity, model=model)
    own, answered = squares(scene, held, seeds, fidelity, quantity)
    chosen, also = squares(scene, found.best.overrides, seeds, fidelity, quantity)
    even = math.nan
    if stack and found.best is not found.own:
        even = _rms(squares(scene, _even(found.best, scene), seeds[:1], fidelity, quantity)[0])
    rng = np.random.default_rng(5)
    draws = []
    for _ in range(_DRAWS):
        one, two = (sums[rng.integers(len(sums), size=len(sums))] for sums in (own, chosen))
        draws.append(_rms(one) / _rms(two))
    low, high = np.quantile(draws, [0.025, 0.975])
    return Compared(
        _rms(own), _rms(chosen), even, _rms(own) / _rms(chosen), float(low), float(high), found.gain, (answered, also),
        found.best.name, (found.factor, found.unit),
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=_SCENES)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--budget", type=float, default=1.0)
    parser.add_argument("--widths", default="1,2")
    parser.add_argument("--slices", default="6,8")
    parser.add_argument("--fidelity", default=None)
    parser.add_argument("--model", default=None)
    given = parser.parse_args(arguments)
    widths = [float(one) for one in given.widths.split(",")]
    print("scene                own       chosen     even  own/chosen  95 % interval   predicted  design")
    reached = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in given.scenes:
            seeds = range(101, 101 + given.seeds)
            one = compared(
                name, seeds=seeds, budget=given.budget, widths=widths, slices=given.slices, fidelity=given.fidelity,
                model=given.model,
            )  # fmt: skip
            reached += one.ratio >= 2.0
            factor, unit = one.shown
            errors = [factor * each for each in (one.own, one.chosen, one.even)]
            print(
                f"{name:17s} {errors[0]:8.4g} {errors[1]:11.4g} {errors[2]:8.4g} {unit:3s} {one.ratio:8.2f}"
                f"  {one.low:.2f} … {one.high:.2f} {one.predicted:13.2f}  {one.name}; answered {one.answered[0]:.3f}, "
                f"{one.answered[1]:.3f}",
                flush=True,
            )
    print(f"{reached} of {len(given.scenes)} scenes gain a factor of 2 or more")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
