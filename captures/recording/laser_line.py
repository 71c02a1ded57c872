"""A survey with a laser line: dark frames first, then frames along stated poses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from ...scenes.base import Spec
from ...scenes.quantities import Place
from ...scenes.rigs import rig_kind
from ...scenes.scene import Scene
from .recipe import Built, Recipe, Slot, Taken, mean_of

__all__ = ["RECIPE", "LineSurvey"]

_Count = Annotated[int, Field(ge=0, le=65536)]


class LineSurvey(Spec):
    """`dark` frames without the laser, then one frame (the mean of `averages`) at each of `positions_m` (x, y, z of the rig), or
    `frames` where it stands still."""

    dark: _Count
    averages: Annotated[int, Field(ge=1, le=65536)]
    frames: Annotated[int, Field(ge=1, le=65536)] | None = None
    positions_m: tuple[Place, ...] | None = None

    @model_validator(mode="after")
    def _frames_are_given_once(self) -> LineSurvey:
        if (self.frames is None) == (not self.positions_m):
            raise ValueError("give frames of a rig that stands still, or positions_m")
        return self

    def poses(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Poses (frame, 6) of the frames, dark ones first, at the first place."""
        places = np.array(self.positions_m or [(0.0, 0.0, 0.0)] * (self.frames or 1), np.float64)
        return np.hstack(
            [np.vstack([np.repeat(places[:1], self.dark, axis=0), places]), np.zeros((self.dark + len(places), 3))]
        )


def _slots(scan: LineSurvey, scene: Scene) -> list[Slot]:
    slots = []
    for frame in range(len(scan.poses())):
        lit = frame >= scan.dark
        settings: dict[str, dict[str, Any]] = {
            "laser": {"laser_on": lit},
            "camera": {"shot": max(frame - scan.dark, 0)},
        }
        slots += [Slot("scan" if lit else "dark", frame, settings)] * scan.averages
    return slots


def _shape(scan: LineSurvey, scene: Scene) -> tuple[int, ...]:
    camera = rig_kind(scene.modality).view(scene.rig).camera
    assert camera is not None
    return camera.rows, camera.cols


def _build(scan: LineSurvey, scene: Scene, taken: Taken, declared: Mapping[str, Any]) -> Built:
    groups = taken.of_group()
    times = taken.times_s()
    coords = {
        "time": np.array([times[group[0]] for group in groups]),
        "valid": np.array([bool(taken.valid[group].all()) for group in groups]),
        "laser_on": np.array([bool(taken.told(int(group[0]), "laser", "laser_on")) for group in groups]),
        "pose": scan.poses(),
    }
    return Built({"counts": mean_of(taken, groups)}, coords, averaged=scan.averages > 1)


RECIPE = Recipe("laser_line", LineSurvey, ("camera", "laser"), _slots, lambda scan, scene: {}, _shape, _build)
