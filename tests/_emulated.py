"""A small emulated rig in this process, whose frames are known numbers: for tests of drivers and recordings."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count

import numpy as np
from numpy.typing import NDArray

from beambench.generator.emulators.bench import Bench, Faults

__all__ = ["SHAPE", "Ramp", "bench", "free_host"]

SHAPE = (24, 32)
_numbers = count(1)


class Ramp:
    """Frames that tell their shot and delay: a ramp plus 7·shot, and the delay in whole 10 ps in the last pixel."""

    shape = SHAPE

    def __init__(self) -> None:
        self.seen: list[tuple[float, bool, int]] = []

    def frame(self, delay_s: float, *, pulses: int, exposure_s: float, laser_on: bool, shot: int) -> NDArray[np.uint16]:
        self.seen.append((delay_s, laser_on, pulses))
        image = (np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) + 7 * shot).astype(np.uint16)
        image[-1, -1] = round(delay_s / 1e-11) if laser_on else 0
        return image


def free_host() -> str:
    """A loopback address of this process alone: GigE cameras have one port, so each needs an address."""
    process = os.getpid()
    return f"127.{16 + process % 97}.{process // 97 % 256}.{1 + next(_numbers) % 250}"


@contextmanager
def bench(faults: Faults | None = None, *, seed: int = 1, host: str = "") -> Iterator[tuple[Bench, Ramp]]:
    """A rig that serves until the block ends."""
    sight = Ramp()
    rig = Bench(
        sight,
        host or free_host(),
        serial="EMU0001",
        seed=seed,
        faults=faults or Faults(),
        control_port=3956,
        delay_port=0,
    )
    rig.start()
    try:
        yield rig, sight
    finally:
        rig.close()
