"""Rigs: one file per kind of instrument, with its spec, its checks and what it declares; `RIGS` lists them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .kind import RigKind

__all__ = ["RIGS", "rig_kind"]

#: kind of rig, which is the modality of its captures -> "module:object". A rig that gives no kind is of the first.
RIGS: dict[str, str] = {
    "gated": "beambench.scenes.rigs.gated:KIND",
    "waveform": "beambench.scenes.rigs.waveform:KIND",
    "amcw": "beambench.scenes.rigs.amcw:KIND",
    "laser_line": "beambench.scenes.rigs.laser_line:KIND",
    "wavefront": "beambench.scenes.rigs.wavefront:KIND",
}


def rig_kind(name: object) -> RigKind[Any]:
    """The record of a kind of rig. Raises InputError for an unknown one."""
    from ..records import record_of

    kind: RigKind[Any] = record_of(RIGS, name, "There is no such kind of rig.", "rig.kind")
    return kind
