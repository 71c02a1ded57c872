"""The pilot: some rows of the first frame by every rung, the full one with as many paths as it takes to decide between them.

Rows at full resolution show what an image of fewer, wider pixels would not: a line is about a pixel wide. The error of a rung is
ε² = Σ(X − R₁)(X − R₂)/ΣR₁R₂ with the two halves of the traced light in R₁ and R₂, so that the pilot's own noise drops out. Its
interval is that of a bootstrap over the rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..random import resampler
from .expected import FrameLight, tracing_of
from .full import MOST_SAMPLES
from .setting import Pose, Setting

__all__ = ["Traced", "image_error", "pilot_rounds"]

Float = NDArray[np.float64]

#: Most and fewest rows of the pilot, the pixels that it should have, and paths of each pixel after each round.
_ROWS, _PIXELS, _SAMPLES = (12, 4), 1024, (32, 128, 512, 2048)


@dataclass(frozen=True, eq=False)
class Traced:
    """A round's result. `errors`: (ε, low, high) of the cheaper rungs; `full`: standard error that the full rung is left with when
    its paths are used up; `paths` per pixel; `rows` of the pilot."""

    errors: dict[str, tuple[float, float, float]]
    full: float
    paths: int
    rows: int


def image_error(x: Float, one: Float, two: Float, seed: int = 0, draws: int = 400) -> tuple[float, float, float]:
    """ε of an image x (rows, cols) against two independent references, and its 95 % interval by a bootstrap over rows. What is
    negative by noise is zero."""
    above, below = ((x - one) * (x - two)).sum(axis=-1), (one * two).sum(axis=-1)
    if not below.sum() > 0:
        return 0.0, 0.0, 0.0
    pick = resampler(seed).multinomial(above.size, np.full(above.size, 1 / above.size), size=draws)
    ratios = (pick @ above) / np.maximum(pick @ below, 1e-300)
    low, high = np.sqrt(np.maximum(np.percentile(ratios, [2.5, 97.5]), 0.0))
    return float(np.sqrt(max(float(above.sum() / below.sum()), 0.0))), float(low), float(high)


def pilot_rounds(setting: Setting, pose: Pose, light: FrameLight, seed: int, key: int) -> Iterator[Traced]:
    """Estimates from more and more paths; `light` as of `frame_light`, in full. Raises InputError as the full rung does."""
    count = int(np.clip(_PIXELS // setting.rig.camera.cols, _ROWS[1], _ROWS[0]))
    rows = np.unique(np.linspace(0, setting.rig.camera.rows - 1, count).round().astype(np.intp))
    # A number beyond that of any frame: the pilot's paths are not those of the rendering.
    tracing = tracing_of(setting, pose, light, (seed, key, 1 << 20), rows)
    shape = (rows.size, setting.rig.camera.cols)
    line = light.line[rows]
    stacks = {"direct": line}
    known = line
    if light.scattered is not None:
        known = line + light.scattered.curtain[rows]
        stacks["scatter"] = known + light.scattered.halo[rows]
    for wanted in _SAMPLES:
        tracing.add(wanted - tracing.samples)
        rest = tracing.result(known.ravel(), 0.0)
        one, two = (known + half.reshape(shape) for half in rest.halves)
        errors = {name: image_error(image, one, two) for name, image in stacks.items()}
        yield Traced(errors, rest.epsilon * float(np.sqrt(rest.samples / MOST_SAMPLES)), rest.samples, rows.size)
