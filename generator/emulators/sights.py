"""The table of emulated rigs: how each modality that has one is emulated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...scenes.records import record_of

if TYPE_CHECKING:
    from ...scenes.scene import Scene
    from .bench import Emulation, Sight

__all__ = ["EMULATIONS", "emulated"]

#: modality -> "module:object"
EMULATIONS: dict[str, str] = {
    "gated": "beambench.generator.emulators.gated_sight:EMULATION",
}


def emulated(scene: Scene, hidden: int, seed: int) -> tuple[Scene, Sight]:
    """The scene with its hidden values, and what its rig sees. Raises InputError for a modality that is not emulated."""
    emulation: Emulation = record_of(
        EMULATIONS, scene.modality, "There is no emulated rig of this modality.", "rig.kind"
    )
    true = emulation.hidden(scene, hidden)
    return true, emulation.sight(true, seed)
