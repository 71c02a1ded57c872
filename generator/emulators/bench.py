"""The cables of an emulated rig: a trigger of the delay generator fires the laser and exposes the camera; faults on request."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...scenes.scene import Scene
from ..random import Stage, generator
from .camera import EmulatedCamera
from .delay_generator import DelayGenerator

__all__ = ["Bench", "Emulation", "Faults", "Sight"]

#: A laser with a TTL input fires above this amplitude of the output AB.
_TTL_V = 2.0
_AB, _A, _C = 1, 2, 4


class Sight(Protocol):
    """What a camera sees."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame."""
        ...

    def frame(self, delay_s: float, *, pulses: int, exposure_s: float, laser_on: bool, shot: int) -> NDArray[np.uint16]:
        """Counts of one shot."""
        ...


@dataclass(frozen=True)
class Emulation:
    """How a modality is emulated: `hidden` (scene, seed) gives the rig its true values, `sight` (scene, seed) what it sees, and
    `table` (file, seed) the scene and the sight of a table of expectations."""

    hidden: Callable[[Scene, int], Scene]
    sight: Callable[[Scene, int], Sight]
    table: Callable[[Path, int], tuple[Scene, Sight]]


@dataclass(frozen=True)
class Faults:
    """Faults on request.

    Main arguments:
        loss: share of stream packets that never arrive.
        stall: share of the shots that leave no image at all.
        dies_after: number of shots after which the process ends at once, None for never.
    """

    loss: float = 0.0
    stall: float = 0.0
    dies_after: int | None = None


class Bench:
    """A laser on output AB of the delay generator, a gate on CD, and a camera that T0 triggers (its Line0)."""

    def __init__(
        self, sight: Sight, host: str, *, serial: str, seed: int, faults: Faults, control_port: int, delay_port: int
    ) -> None:
        self._sight, self._faults = sight, faults
        self._draw = generator(seed, 0, Stage.FAULTS, 0)
        self._shots = 0
        self._lock = threading.Lock()
        self.delays = DelayGenerator(host, delay_port, self.fire)
        rows, cols = sight.shape
        self.camera = EmulatedCamera(
            host, rows, cols, serial=serial, expose=self.expose, draw=generator(seed, 0, Stage.FAULTS, 1),
            loss=faults.loss, port=control_port,
        )  # fmt: skip

    def start(self) -> None:
        """Serve."""
        self.camera.start()
        self.delays.start()

    def close(self) -> None:
        """Stop serving, as a rig whose plug is pulled."""
        self.camera.close()
        self.delays.close()

    def fire(self, generator: DelayGenerator) -> None:
        """A trigger of the delay generator."""
        self._shot(self.camera.waits_for("Line0"))

    def expose(self) -> None:
        """A trigger of the camera, whose strobe triggers the delay generator."""
        self._shot(True)

    def _shot(self, seen: bool) -> None:
        with self._lock:
            self._shots += 1
            if self._faults.dies_after is not None and self._shots > self._faults.dies_after:
                sys.stderr.flush()
                os._exit(9)
            stalled = self._faults.stall > 0.0 and self._draw.random() < self._faults.stall
            if not seen or stalled:
                return
            delays = self.delays
            frame = self._sight.frame(
                delays.time_s(_C) - delays.time_s(_A), pulses=delays.pulses, exposure_s=self.camera.exposure_s,
                laser_on=delays.level_v(_AB) >= _TTL_V, shot=self._shots,
            )  # fmt: skip
            self.camera.send(frame)
