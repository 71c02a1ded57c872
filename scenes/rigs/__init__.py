"""Rigs: one file per kind of instrument, with its spec, its checks and what it declares; `RIGS` lists them."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .kind import RigKind

__all__ = ["RIGS", "rig_kind"]

#: kind of rig, which is the modality of its captures -> "module:object". A rig that gives no kind is of the first.
RIGS: dict[str, str] = {
    "gated": "beambench.scenes.rigs.gated:KIND",
    "waveform": "beambench.scenes.rigs.waveform:KIND",
    "amcw": "beambench.scenes.rigs.amcw:KIND",
}


@lru_cache(maxsize=64)
def rig_kind(name: object) -> RigKind[Any]:
    """The record of a kind of rig. Raises InputError for an unknown one."""
    from ..errors import InputError

    if not isinstance(name, str) or name not in RIGS:
        raise InputError("There is no such kind of rig.", where="rig.kind", value=name, allowed=", ".join(RIGS))
    module, _, attribute = RIGS[name].partition(":")
    kind: RigKind[Any] = getattr(import_module(module), attribute)
    return kind
