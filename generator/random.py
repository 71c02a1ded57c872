"""Random numbers that depend on what is drawn, never on the worker that draws.

`SeedSequence(seed, spawn_key=(capture_key, stage, block))`: blocks of 16 rows whatever the tiling or the worker.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

__all__ = [
    "BLOCK_ROWS", "Stage", "blocks", "drawn_from", "generator", "jitter_about_mean", "jitter_of_mean", "resampler", "sequence",
]  # fmt: skip

#: Rows of one block of random numbers.
BLOCK_ROWS = 16


class Stage(IntEnum):
    """What is drawn. Never renumber: old captures must regenerate."""

    ENERGY = 1
    JITTER = 2
    PHOTONS = 3
    INTENSIFIER = 4
    DARK = 5
    READ = 6
    PRNU = 7
    DSNU = 8
    PATHS = 9
    PULSES = 10  # mean jitter of the pulses of a slice or record
    SPECKLE = 11
    INCLINATION = 12
    SCREEN = 20  # turbulence; a block is a frame and a layer
    POINTING = 21
    IMAGER = 22  # the camera beside the lenslets; a block is a frame
    HIDDEN = 23  # by how much an emulated rig differs from what is written down
    FAULTS = 24  # of an emulated rig: lost packets and silent shots; a block is an instrument


class _Count:
    """How many sequences of random numbers were begun in this process."""

    begun = 0


def drawn_from() -> int:
    """Number of sequences of random numbers begun so far: what leaves it as it was depends on no seed.

    All randomness of the generator begins in this file (a test looks for others).
    """
    return _Count.begun


def sequence(seed: int, spawn_key: tuple[int, ...]) -> np.random.SeedSequence:
    """`SeedSequence(seed, spawn_key)`."""
    _Count.begun += 1
    return np.random.SeedSequence(seed, spawn_key=spawn_key)


def generator(seed: int, capture_key: int, stage: Stage, block: int = 0) -> np.random.Generator:
    """The random generator of one stage and block."""
    return np.random.Generator(np.random.SFC64(sequence(seed, (capture_key, int(stage), block))))


def resampler(seed: int) -> np.random.Generator:
    """The random generator of a bootstrap, which no value of a capture depends on."""
    _Count.begun += 1
    return np.random.default_rng(seed)


def blocks(rows: int) -> list[tuple[int, slice]]:
    """(block number, rows) of every block."""
    return [(i, slice(r, min(r + BLOCK_ROWS, rows))) for i, r in enumerate(range(0, rows, BLOCK_ROWS))]


def jitter_of_mean(jitter_s: float, pulses: int) -> float:
    """σ/√M, s: rms of the mean delay of M pulses that jitter by σ each. It moves all that these pulses show."""
    return jitter_s / float(np.sqrt(pulses))


def jitter_about_mean(jitter_s: float, pulses: int) -> float:
    """σ√(1 − 1/M), s: rms of single pulses about the mean of their M: what broadens the sum of their light. 0 for one pulse.

    That of the average sum: how far a draw of few pulses differs in width and shape is left out.
    """
    return jitter_s * float(np.sqrt(1.0 - 1.0 / pulses))
