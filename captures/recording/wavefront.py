"""A sequence of a Shack-Hartmann sensor: the reference of a flat wavefront first, then the frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ...scenes.base import Spec
from ...scenes.quantities import MomentTime
from ...scenes.rigs import rig_kind
from ...scenes.scene import Scene
from .recipe import Built, Recipe, Slot, Taken, mean_of

__all__ = ["RECIPE", "WavefrontSequence"]

_Times = Annotated[int, Field(ge=1, le=65536)]


class WavefrontSequence(Spec):
    """`reference` frames of a flat wavefront, whose mean is the reference; then `frames`, gated `delay_s` after the pulse."""

    reference: _Times
    frames: _Times
    delay_s: MomentTime


def _slots(scan: WavefrontSequence, scene: Scene) -> list[Slot]:
    flat = [Slot("reference", 0, {"source": {"reference": True}})] * scan.reference
    return flat + [
        Slot("scan", frame + 1, {"source": {"reference": False}, "camera": {"shot": frame}})
        for frame in range(scan.frames)
    ]


def _shape(scan: WavefrontSequence, scene: Scene) -> tuple[int, ...]:
    _, rows, cols = rig_kind(scene.modality).sizes(scene.rig)
    camera = rig_kind(scene.modality).view(scene.rig).camera
    return (camera.rows, camera.cols) if camera is not None else (rows, cols)


def _build(scan: WavefrontSequence, scene: Scene, taken: Taken, declared: Mapping[str, Any]) -> Built:
    flat, *frames = taken.of_group()
    sound = flat[taken.valid[flat]]
    shape = taken.data.shape[1:]
    reference = taken.data[sound].mean(axis=0, dtype=np.float64) if sound.size else np.full(shape, np.nan)
    chosen = np.concatenate(frames)
    coords = {
        "time": taken.times_s()[chosen],
        # Without a reference no frame can be read.
        "valid": taken.valid[chosen] & bool(sound.size),
        "delay": np.full(len(chosen), scan.delay_s + float(declared["t0_s"])),
    }
    return Built({"counts": mean_of(taken, frames), "reference": reference.astype(np.float32)}, coords)


RECIPE = Recipe("wavefront", WavefrontSequence, ("camera", "source"), _slots, lambda scan, scene: {}, _shape, _build)
