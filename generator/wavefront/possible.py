"""What a rung cannot model is refused before any light is traced."""

from __future__ import annotations

from ...scenes.errors import InputError
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.scene import Scene

__all__ = ["check_rung"]


def check_rung(scene: Scene, rung: str) -> None:
    """Raise InputError for a rung that does not model the scene: speckle needs fields, and so `isolated` or `coherent`."""
    rig = wavefront_rig(scene)
    if rung == "geometric" and rig.speckle_modes is not None:
        raise InputError(
            "The rung geometric has no speckle.", where=f"{scene.name}: rig.speckle_modes", value=rig.speckle_modes,
            next_step='give fidelity="isolated" or "coherent", or leave speckle_modes out',
        )  # fmt: skip
