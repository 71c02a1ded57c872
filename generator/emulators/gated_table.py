"""An emulated rig that starts at once: its expectation was rendered before, delay by delay, and each shot draws the noise only."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern

__all__ = ["GatedTable", "write_table"]

#: Delays that differ by less are the same setting of a delay generator.
_SAME_S = 5e-13


def write_table(
    file: Path, scene: Scene, delays_s: NDArray[np.float64], electrons: NDArray[np.float32], ambient: float
) -> None:
    """Write a table: expected photoelectrons (delay, row, col) without dark current at each delay as it is set, and those of
    ambient light alone."""
    text = json.dumps(scene.model_dump(mode="json"))
    np.savez(file, delays_s=delays_s, electrons=electrons, ambient=np.float64(ambient), scene=np.array(text))


class GatedTable:
    """Frames from the table in `file`. Raises InputError for a file that is none."""

    def __init__(self, file: Path, seed: int) -> None:
        try:
            with np.load(file, allow_pickle=False) as stored:
                self._delays, self._electrons = stored["delays_s"], stored["electrons"]
                self._ambient, text = float(stored["ambient"]), str(stored["scene"])
        except (OSError, ValueError, KeyError) as error:
            raise InputError("This is no table of an emulated rig.", where=str(file), value=str(error)) from error
        self.scene, self._seed = load_scene(json.loads(text)), seed
        rig = gated_rig(self.scene)
        self._pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        rows, cols = self._electrons.shape[1:]
        return int(rows), int(cols)

    def frame(self, delay_s: float, *, pulses: int, exposure_s: float, laser_on: bool, shot: int) -> NDArray[np.uint16]:
        """As `GatedSight.frame`; a delay that is not in the table shows ambient light only, and pulses and exposure are those
        of the scene."""
        near = int(np.argmin(np.abs(self._delays - delay_s)))
        lit = laser_on and abs(float(self._delays[near]) - delay_s) < _SAME_S
        mean = self._electrons[near] if lit else np.full(self.shape, self._ambient, np.float32)
        return np.asarray(detect(mean[None], gated_rig(self.scene).detector, self._pattern, self._seed, shot)[0])
