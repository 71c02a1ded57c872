"""The condition "mismatched" of a capture: what `suites.mismatch` declares wrongly, with the clock of the modality."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ...generator.models import model_of
from ...scenes.scene import Scene
from ..suites.mismatch import mismatched_capture

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["wrongly_declared"]


def wrongly_declared(scene: Scene, mismatch: Mapping[str, float], hidden: xr.Dataset) -> xr.Dataset:
    """A capture without truth, given with a rig that is declared wrong. Raises InputError where no error applies."""
    return mismatched_capture(hidden, scene, mismatch, model_of(scene.modality).clock)
