"""The view of a gated rig: its camera and its laser, for one slice."""

from __future__ import annotations

from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..rays.lamp import RoundBeam
from ..rays.view import View

__all__ = ["view_of"]


def view_of(scene: Scene) -> View[RoundBeam]:
    """Camera, laser and pulses of a slice. Raises InputError for a scene of another modality."""
    rig = gated_rig(scene)
    laser = rig.laser
    lamp = RoundBeam(laser.illumination, laser.position_m, laser.source_radius_m)
    return View(rig.camera, lamp, laser.pulse_energy_j, rig.pulses_per_slice, laser.wavelength_m)
