"""What a rung cannot model is refused before any light is traced."""

from __future__ import annotations

from ...scenes.errors import InputError
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.scene import Scene

__all__ = ["MOST_ROTATION_DEG", "check_rung"]

#: Greatest turn of the array at which its spots are taken as those of lenslets parallel to the pixels: their side lobes, 5 % of the
#: light, turn with them, by a tenth of their width at most.
MOST_ROTATION_DEG = 2.0


def check_rung(scene: Scene, rung: str) -> None:
    """Raise InputError for a rung that does not model the scene: speckle needs fields, and so `isolated` or `coherent`, whose
    lenslets stand parallel to the pixels."""
    rig = wavefront_rig(scene)
    if rung in ("isolated", "coherent") and abs(rig.lenslets.rotation_deg) > MOST_ROTATION_DEG:
        raise InputError(
            f"The rung {rung} has lenslets whose sides are parallel to the pixels.",
            where=f"{scene.name}: rig.lenslets.rotation_deg", value=rig.lenslets.rotation_deg,
            allowed=f"-{MOST_ROTATION_DEG:g} to {MOST_ROTATION_DEG:g}", next_step='give fidelity="geometric"',
        )  # fmt: skip
    if rung == "geometric" and rig.speckle_modes is not None:
        raise InputError(
            "The rung geometric has no speckle.", where=f"{scene.name}: rig.speckle_modes", value=rig.speckle_modes,
            next_step='give fidelity="isolated" or "coherent", or leave speckle_modes out',
        )  # fmt: skip
