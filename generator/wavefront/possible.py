"""What a rung cannot model is refused before any light is traced."""

from __future__ import annotations

from ...scenes.errors import InputError
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.scene import Scene

__all__ = ["MOST_ROTATION_DEG", "check_rung"]

#: Greatest turn of the array at which its spots are taken as those of lenslets parallel to the pixels: their side lobes, a
#: tenth of the light, turn with them.
MOST_ROTATION_DEG = 2.0


def check_rung(scene: Scene, rung: str) -> None:
    """Raise InputError for a rung that does not model the scene: the lenslets of `isolated` and `coherent` stand parallel to the
    pixels."""
    rig = wavefront_rig(scene)
    if rung in ("isolated", "coherent") and abs(rig.lenslets.rotation_deg) > MOST_ROTATION_DEG:
        raise InputError(
            f"The rung {rung} has lenslets whose sides are parallel to the pixels.",
            where=f"{scene.name}: rig.lenslets.rotation_deg", value=rig.lenslets.rotation_deg,
            allowed=f"-{MOST_ROTATION_DEG:g} to {MOST_ROTATION_DEG:g}", next_step='give fidelity="geometric"',
        )  # fmt: skip
