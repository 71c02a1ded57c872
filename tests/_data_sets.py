"""Small data sets for tests: captures of some kB, of every modality."""

from __future__ import annotations

import copy
from typing import Any

__all__ = ["ALL_KINDS", "QUICK", "TINY", "tiny"]

_GATED = {"rig.camera.rows": 6, "rig.camera.cols": 5, "rig.delays.count": 8, "rig.camera.pixel_pitch_m": 1e-4}

_SENSOR = {
    "rig.lenslets.across": 8, "rig.turbulence.layers.0.r0_m": 1.0e-2, "rig.pupil.diameter_m": 1.2e-3, "rig.pupil.modes": 10,
    "rig.camera.rows": 80, "rig.camera.cols": 80, "rig.frames.count": 1, "rig.frames.reference_exposures": 2,
}  # fmt: skip

#: A gated data set of two base scenes, with a parameter of each kind.
TINY: dict[str, Any] = {
    "schema_version": 1,
    "dataset": "tiny",
    "captures": 40,
    "seed": 3,
    "fidelity": "direct",
    "rtol": 1e-2,
    "scenes": [{"scene": "step", "overrides": _GATED}, {"scene": "tilted-wall", "overrides": _GATED}],
    "split": {"train": 0.6, "validation": 0.2, "test": 0.2},
    "parameters": {
        "albedo": {"kind": "uniform", "low": 0.1, "high": 0.9, "paths": ["target.0.material.albedo"]},
        "energy_j": {"kind": "log_uniform", "low": 1e-6, "high": 1e-5, "paths": ["rig.laser.pulse_energy_j"]},
    },
}

#: One base scene of each modality.
ALL_KINDS: dict[str, Any] = {
    "schema_version": 1,
    "dataset": "all-kinds",
    "captures": 10,
    "seed": 7,
    "fidelity": "direct",
    "rtol": 0.1,
    "scenes": [
        {"scene": "tilted-wall", "overrides": _GATED},
        {"scene": "photodetector-5m", "overrides": {"rig.record.shots": 3, "rig.record.samples": 128}},
        {"scene": "amcw", "overrides": {"rig.shots": 4}},
        {"scene": "line-step", "overrides": {"rig.camera.rows": 24, "rig.camera.cols": 192, "rig.frames.lit": 1}},
        {"scene": "gated-turbulence", "overrides": _SENSOR, "fidelity": "geometric"},
    ],
    "parameters": {"turn": {"kind": "uniform", "low": 0.9, "high": 1.0}},
}

#: The quickest data set: six shards of four captures.
QUICK: dict[str, Any] = {
    "schema_version": 1,
    "dataset": "quick",
    "captures": 24,
    "per_shard": 4,
    "seed": 1,
    "fidelity": "direct",
    "rtol": 0.1,
    "scenes": [{"scene": "counter", "overrides": {"rig.record.shots": 4}}],
    "parameters": {"albedo": {"kind": "uniform", "low": 0.05, "high": 0.9, "paths": ["target.0.material.albedo"]}},
}


def tiny(source: dict[str, Any] = TINY, **changes: Any) -> dict[str, Any]:
    """A copy of a data set with other values."""
    return copy.deepcopy(source) | changes
