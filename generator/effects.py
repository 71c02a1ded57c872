"""The catalogue of effects: what the `direct` rung models, what it neglects, and how large that is predicted to be.

Sizes are relative to the signal, by closed forms; None where no bound is known for this scene.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..scenes.scene import Scene
from ..scenes.shapes import Rectangle, Sphere
from .direct import DirectScene
from .echo import albedo_at_normal

__all__ = ["catalogue"]


def catalogue(scene: Scene, direct: DirectScene) -> list[dict[str, Any]]:
    """Every catalogued effect: `name`, `modelled`, `predicted_relative_size` (or None), `basis`."""
    rig = scene.rig
    distance = direct.truth["truth_range"]
    typical = float(np.nanmedian(distance)) if np.isfinite(distance).any() else 0.0
    b = scene.medium.scattering_per_m
    detector, laser, tube = rig.detector, rig.laser, rig.detector.intensifier

    def effect(name: str, modelled: bool, size: float | None, basis: str) -> dict[str, Any]:
        return {"name": name, "modelled": modelled, "predicted_relative_size": size, "basis": basis}

    return [
        effect("first bounce", True, 1.0, "Mitsuba first hits, exact times"),
        effect("sub-pixel mixtures", True, None, "adaptive sub-pixel rays"),
        effect(
            "beam attenuation", True, float(-np.expm1(-2 * scene.medium.attenuation_per_m * typical)), "1 − e^(−2cr)"
        ),
        effect("group index", True, None, "all times at c/n_g"),
        effect("forward-scattered light", False, float(np.expm1(min(2 * b * typical, 50.0))), "e^(2br) − 1, wide beam"),
        effect("volume backscatter", False, 0.0 if b == 0 else None, "needs the phase function"),
        effect("interreflection", False, *_interreflection(scene)),
        effect("finite source and aperture", False, None, "point source and pinhole"),
        effect("lens point spread", False, None, "pinhole"),
        effect("pulse energy fluctuation", bool(laser.energy_fluctuation), laser.energy_fluctuation, "rms per slice"),
        effect("jitter of single shots", bool(laser.jitter_shot_s), None, "broadens R"),
        effect("jitter of frames", bool(laser.jitter_frame_s), None, "moves the slice's delay"),
        effect("per-pixel gate timing", rig.gate_map is not None, None, "iris and skew"),
        effect("photon noise", True, None, "Poisson"),
        effect("dark current", True, None, "Poisson"),
        effect("read noise", True, None, "Gaussian"),
        effect("PRNU", bool(detector.prnu), detector.prnu, "rms"),
        effect("DSNU", bool(detector.dsnu_e), None, "fixed offsets"),
        effect("intensifier excess noise", tube is not None, None, "gamma"),
        effect("phosphor spread", tube is not None and tube.phosphor_sigma_px > 0, None, "Gaussian"),
        effect("microchannel-plate saturation", False, None if tube is not None else 0.0, "not modelled"),
        effect("speckle", False, None, "not modelled; contrast 1/√M"),
        effect("motion between slices", False, 0.0, "scene and rig are still"),
    ]


def _interreflection(scene: Scene) -> tuple[float | None, str]:
    """Size of second bounces: zero where no surface faces another, else unknown to this rung, with an upper bound."""
    shapes = [item.shape for item in scene.target]
    flat = all(isinstance(s, Rectangle) and s.tilt_x_deg == 0 and s.tilt_y_deg == 0 for s in shapes)
    if flat or (len(shapes) == 1 and isinstance(shapes[0], Rectangle | Sphere)):
        return 0.0, "no surface faces another"
    brightest = max(albedo_at_normal(item.material) for item in scene.target)
    return None, f"unknown; at most the largest albedo, {brightest:.2g}"
