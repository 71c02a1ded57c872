"""The table of emulated rigs: how each modality that has one is emulated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...scenes.records import record_of

if TYPE_CHECKING:
    from pathlib import Path

    from ...scenes.scene import Scene
    from .bench import Emulation, Sight

__all__ = ["EMULATIONS", "emulated"]

#: modality -> "module:object"
EMULATIONS: dict[str, str] = {
    "gated": "beambench.generator.emulators.gated_sight:EMULATION",
}


def emulated(scene: Scene, hidden: int, seed: int, table: Path | None = None) -> tuple[Scene, Sight]:
    """The scene with its hidden values, and what its rig sees.

    Other arguments:
        table: a file of expectations that were rendered before, whose scene counts; only the modality of `scene` does then.

    Raises InputError for a modality that is not emulated, and for a file that is no table.
    """
    emulation: Emulation = record_of(
        EMULATIONS, scene.modality, "There is no emulated rig of this modality.", "rig.kind"
    )
    if table is not None:
        return emulation.table(table, seed)
    true = emulation.hidden(scene, hidden)
    return true, emulation.sight(true, seed)
