"""The condition "mismatched": the rig is declared wrong by stated amounts, as after a calibration that was careless or long
ago.

    conditions = ["matched", "mismatched"]

    [mismatch]
    t0 = 2e-11              # s: the declared zero of time is 20 ps late
    pulse-width = 0.05      # 1: the declared pulse is 5 % longer than the true one

 Each is a stress of the declared rig (`stress_axes`, "wrong-…"), applied to what estimators are given and to nothing else:
captures, truth and bounds are those of the condition "matched", noise included, so that the two differ by the error alone. A
coordinate of times moves with the declared zero of time, as it would in the laboratory.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...scenes.declared import declared_rig
from ...scenes.errors import InputError
from ...scenes.rigs import RIGS, rig_kind
from ...scenes.scene import Scene
from .stress import stressed

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["ERRORS", "applies", "check_mismatch", "mismatched", "mismatched_capture"]

#: What may be wrong -> (the stress of the declared rig, the role that the rig needs; "" for one that every rig has).
ERRORS: dict[str, tuple[str, str]] = {
    "t0": ("wrong-t0", ""),
    "index": ("wrong-index", ""),
    "phase-index": ("wrong-phase-index", "baseline"),
    "pulse-width": ("wrong-pulse", "pulse"),
    "gate-width": ("wrong-gate", "gates"),
    "baseline": ("wrong-baseline", "baseline"),
    "pitch": ("wrong-pitch", "pitch"),
}


def check_mismatch(mismatch: Mapping[str, float], where: str) -> None:
    """Refuse errors that have no name or no amount. Raises InputError."""
    for name, amount in mismatch.items():
        if name not in ERRORS or not np.isfinite(amount) or amount == 0.0:
            raise InputError(
                "This is no error of a declared rig.", where=f"{where}: mismatch.{name}", value=amount,
                allowed=f"a number that is not 0, for one of: {', '.join(ERRORS)}",
            )  # fmt: skip


def applies(name: str, scene: Scene) -> bool:
    """Whether a scene's rig can be declared wrong in this way; what its estimators are not given cannot be."""
    role = ERRORS[name][1]
    if role and role not in rig_kind(scene.modality).roles:
        return False
    try:
        changed, *_ = stressed(scene, [(ERRORS[name][0], 1e-3 if name != "t0" else 1e-12)])
        return declared_rig(changed) != declared_rig(scene)
    except InputError:
        return False


def mismatched(scene: Scene, mismatch: Mapping[str, float]) -> Scene:
    """The scene with a rig that is declared wrong; errors that do not apply to it are left out.

    Raises:
        InputError: none applies, or an amount that leaves no possible rig.
    """
    levels = [(ERRORS[name][0], amount) for name, amount in mismatch.items() if applies(name, scene)]
    if not levels:
        raise InputError(
            "No error of the suite's mismatch applies to this scene.", where=f"{scene.name}: mismatch", value=dict(mismatch),
            allowed=f"errors of its rig; {', '.join(RIGS)} differ in what they have",
            next_step='leave the condition "mismatched" out of this scene\'s conditions',
        )  # fmt: skip
    changed = scene
    for level in levels:  # one after another: each keeps the earlier ones' declared values
        changed = stressed(changed, [level])[0]
    return changed


def mismatched_capture(hidden: xr.Dataset, scene: Scene, mismatch: Mapping[str, float], clock: str) -> xr.Dataset:
    """A capture without truth as it is given under the condition: another declared rig, and times that count from its zero.

    Main arguments:
        clock: name of the coordinate of times that starts at the rig's zero; "" for none.
    """
    declared = declared_rig(mismatched(scene, mismatch))
    shift = float(declared["t0_s"]) - float(json.loads(str(hidden.attrs["rig"]))["t0_s"])
    found = hidden.assign_attrs(rig=json.dumps(declared, allow_nan=False))
    if not clock or clock not in found.coords or shift == 0.0:
        return found
    old = found[clock]
    return found.assign_coords({clock: (old.dims, np.asarray(old.values) + shift, old.attrs)})
