"""The amplitude-modulated rig as declared."""

from __future__ import annotations

from typing import Any

from ..scene import Scene
from .amcw import AmcwRig
from .declare import as_declared, medium_data
from .declare_waveform import illumination_data

__all__ = ["declared_amcw"]


def declared_amcw(scene: Scene) -> dict[str, Any]:
    """Plain data of an AMCW rig as declared (attribute `rig` of a capture). Raises InputError as `declared_rig`."""
    rig, medium = as_declared(scene, AmcwRig)
    laser = rig.laser
    return {
        "schema": 1,
        "kind": rig.kind,
        "laser": {
            "wavelength_m": laser.wavelength_m,
            "power_w": laser.power_w,
            "modulation_depth": laser.modulation_depth,
            **illumination_data(laser.illumination),
            "power_fluctuation": laser.power_fluctuation,
        },
        "receiver": rig.receiver.model_dump(mode="json"),
        "modulation": rig.modulation.model_dump(mode="json"),
        "medium": medium_data(medium, laser.wavelength_m),
        "detector": rig.detector.model_dump(mode="json"),
        "shots": rig.shots,
        "scan_half_angle_rad": rig.scan_half_angle_rad,
        "range_window_m": list(rig.range_window_m),
        "ambient_e_per_s": rig.ambient_e_per_s,
        "t0_s": rig.t0_s,
    }
