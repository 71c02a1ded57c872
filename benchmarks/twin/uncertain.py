"""Uncertain values of a twin's rig: what each draw draws anew.

Values with a standard error are drawn one by one; those whose covariance the rig holds (`rig.calibration`, with `paths` and
`covariance`) are drawn together. What a scene refuses below 0 stays at 0 or above.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.overrides import apply_overrides

__all__ = ["Uncertain", "held_at", "perturbed", "uncertain_of"]

_GAIN = ".gain_dn_per_e"
#: Measured in DN, beside a gain: another gain comes with inversely many electrons.
_IN_DN = ("read_noise_e", "dsnu_e")
#: Values this many standard errors from 0 do not come there.
_FAR = 6.0
#: A value below 0, to ask whether a scene takes one.
_BELOW = -1e-9


@dataclass(frozen=True, eq=False)
class Uncertain:
    """What is uncertain.

    Main arguments:
        sigmas: {path: 1 σ} of values that are drawn one by one. joint: paths that are drawn together, and root (path, n): of their
            covariance, root·rootᵀ. floored: paths whose values stay at 0 or above.
    """

    sigmas: Mapping[str, float]
    joint: tuple[str, ...]
    root: npt.NDArray[np.float64]
    floored: frozenset[str]

    @property
    def count(self) -> int:
        """How many values."""
        return len(self.sigmas) + len(self.joint)


def uncertain_of(data: Any, sigmas: Mapping[str, float]) -> Uncertain:
    """What is uncertain of a scene (plain data) whose rig file states standard errors.

    Raises InputError for a path of no number.
    """
    held = data["rig"].get("calibration")
    known = bool(sigmas) and isinstance(held, Mapping) and {"paths", "covariance"} <= set(held)
    joint = tuple(f"rig.{path}" for path in held["paths"]) if known else ()
    _check_numbers(data, [*sigmas, *joint])
    root = np.zeros((0, 0))
    spread = dict(sigmas)
    if joint:
        covariance = np.array(held["covariance"], np.float64)
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        spread |= dict(zip(joint, scale.tolist(), strict=True))
    near = [path for path, sigma in spread.items() if 0.0 <= float(held_at(data, path)) < _FAR * sigma]
    alone = {path: sigma for path, sigma in sigmas.items() if path not in joint}
    return Uncertain(alone, joint, root, frozenset(path for path in near if not _takes_negative(data, path)))


def _takes_negative(data: Any, path: str) -> bool:
    """Whether the scene may hold a value below 0 there: a place, an angle."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            load_scene(apply_overrides(data, {path: _BELOW}))
    except InputError:
        return False
    return True


def held_at(data: Any, path: str) -> Any:
    """What plain data hold at a path, None where there is nothing."""
    node = data
    for key in path.split("."):
        if isinstance(node, list):
            node = (
                node[int(key)] if key.isascii() and key.isdigit() and len(key) < 10 and int(key) < len(node) else None
            )
        else:
            node = node.get(key) if isinstance(node, Mapping) else None
    return node


def perturbed(data: Any, uncertain: Uncertain, level: str, rng: np.random.Generator) -> dict[str, Any]:
    """{path: value} drawn anew. Light and noise were measured in DN: they follow the gain.

    Main arguments:
        level: path of the value that the light is proportional to.
    """
    changes: dict[str, Any] = {}
    for path, sigma in uncertain.sigmas.items():
        changes[path] = float(held_at(data, path)) + sigma * float(rng.standard_normal())
    if uncertain.joint:
        away = uncertain.root @ rng.standard_normal(uncertain.root.shape[1])
        changes |= {
            path: float(held_at(data, path)) + float(by) for path, by in zip(uncertain.joint, away, strict=True)
        }
    for path in uncertain.floored:
        changes[path] = max(changes[path], 0.0)
    for path in [path for path in changes if path.endswith(_GAIN)]:
        relative = changes[path] / float(held_at(data, path))
        changes[level] = float(changes.get(level, held_at(data, level))) / relative
        for name in _IN_DN:
            noise = f"{path.removesuffix(_GAIN)}.{name}"
            if held_at(data, noise) is not None:
                changes[noise] = float(changes.get(noise, held_at(data, noise))) / relative
    return changes


def _check_numbers(data: Any, paths: list[str]) -> None:
    for path in paths:
        value = held_at(data, path)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(
                "An uncertainty is of no number of the rig.", where=f"uncertainty: {path}", value=value,
                allowed="the path of a number",
            )  # fmt: skip
