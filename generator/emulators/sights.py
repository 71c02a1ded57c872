"""The table of emulated rigs: how each modality that has one is emulated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...scenes.records import record_of

if TYPE_CHECKING:
    from pathlib import Path

    from ...scenes.scene import Scene
    from .bench import Emulation, Sight

__all__ = ["EMULATIONS", "emulated", "tabled"]

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


def tabled(file: Path, seed: int) -> tuple[Sight, Scene]:
    """What a rig sees whose expectation was rendered before, and its scene. Raises InputError for a file that is no table."""
    from .gated_table import GatedTable

    sight = GatedTable(file, seed)
    return sight, sight.scene
