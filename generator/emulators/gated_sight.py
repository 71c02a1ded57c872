"""What an emulated gated rig sees: one frame at the delay that is programmed, of a rig whose true values nobody was told.

Every frame is `detector(expected(returns, delay))` of the `direct` rung: rays are traced once, and each shot correlates the
echoes with the response at its own delay, then draws its own energy, jitter, photons and noise.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..gated.direct import DirectScene, render_direct
from ..gated.stack import expected_electrons
from ..random import Stage, generator
from .bench import Emulation, Sight
from .gated_table import GatedTable

__all__ = ["EMULATION", "GatedSight", "hidden"]

_RTOL = 3e-3
#: By how much a hidden rig differs from the one that is written down: σ, absolute for t0_s and relative for the others.
_T0_SIGMA_S = 50e-12
_SIGMAS = {
    "rig.detector.gain_dn_per_e": 0.03,
    "rig.detector.read_noise_e": 0.05,
    "rig.laser.pulse_energy_j": 0.1,
    "rig.laser.pulse.fwhm_s": 0.03,
}


def hidden(scene: Scene, seed: int) -> Scene:
    """The scene with a rig that differs from the written one as instruments do; `seed` 0 leaves it as it is."""
    if seed == 0:
        return scene
    draw = generator(seed, 0, Stage.HIDDEN)
    data = scene.model_dump(mode="json")
    changes = {"rig.t0_s": data["rig"]["t0_s"] + _T0_SIGMA_S * float(draw.standard_normal())}
    for path, sigma in _SIGMAS.items():
        factor = 1.0 + sigma * float(np.clip(draw.standard_normal(), -3.0, 3.0))
        node: Any = data
        for key in path.split("."):
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, float):  # a pulse given by samples has no width of its own
            changes[path] = node * factor
    return load_scene(scene, changes)


class GatedSight:
    """Frames of a gated scene. Raises InputError for a scene of another modality, or one whose rig moves."""

    def __init__(self, scene: Scene, seed: int) -> None:
        rig = gated_rig(scene)
        if rig.motion_m_per_s is not None or rig.screen is not None or len(rig.gates) > 1:
            raise InputError(
                "An emulated rig stands still, sees no screen, and has one gate.", where=f"{scene.name}: rig",
                next_step="take a scene without motion_m_per_s and screen",
            )  # fmt: skip
        self.scene, self._seed = scene, seed
        self._pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)
        self._of: dict[tuple[int, float], tuple[Scene, DirectScene]] = {}
        # The first frame loads light transport and compiles kernels: not while a recorder waits.
        self.frame(0.0, pulses=rig.pulses_per_slice, exposure_s=rig.detector.exposure_s, laser_on=True, shot=0)

    @cached_property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        rig = gated_rig(self.scene)
        return rig.camera.rows, rig.camera.cols

    def frame(self, delay_s: float, *, pulses: int, exposure_s: float, laser_on: bool, shot: int) -> NDArray[np.uint16]:
        """Counts (row, col) of shot number `shot`, with the gate `delay_s` after the laser's trigger."""
        scene, direct = self._seen(pulses, exposure_s)
        rig = gated_rig(scene)
        coords = {
            "actual": np.array([delay_s + rig.t0_s]),
            "gate": np.zeros(1, np.int32),
            "pulses": np.array([pulses]),
            "laser_on": np.array([laser_on]),
            "time": np.zeros(1),
        }
        electrons, _ = expected_electrons(scene, direct, coords, self._seed, shot, _RTOL)
        return np.asarray(detect(electrons, rig.detector, self._pattern, self._seed, shot)[0])

    def _seen(self, pulses: int, exposure_s: float) -> tuple[Scene, DirectScene]:
        """The scene with these pulses and this exposure, and its echoes, traced once."""
        key = (pulses, exposure_s)
        if key not in self._of:
            changes = {"rig.pulses_per_slice": pulses, "rig.detector.exposure_s": exposure_s}
            scene = load_scene(self.scene, changes)
            while len(self._of) >= 8:
                self._of.pop(next(iter(self._of)))
            self._of[key] = (scene, render_direct(scene, _RTOL, with_truth=False))
        return self._of[key]


def _tabled(file: Path, seed: int) -> tuple[Scene, Sight]:
    sight = GatedTable(file, seed)
    return sight.scene, sight


EMULATION = Emulation(hidden, GatedSight, _tabled)
