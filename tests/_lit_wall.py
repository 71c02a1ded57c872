"""A wall lit in water, and the path-traced light of a scene, for the tests of the path tracer."""

from __future__ import annotations

from typing import Any

import numpy as np

from beambench.generator.gated.full import Limits, Remainder, render_remainder
from beambench.scenes.load import load_scene
from beambench.scenes.rigs.gated import gated_rig
from beambench.scenes.scene import Scene

from ._gate_closed_form import C, slices_of


def lit_wall(scattering: float, g: float, **more: Any) -> Scene:
    """A wall 3 m away in water, a lamp beside the camera, eight gates about the wall's echo."""
    return load_scene(
        "flat-wall",
        {
            "target.0.shape.center_m": [0.0, 0.0, 3.0],
            "target.0.material.albedo": 0.6,
            "medium": {
                "name": "water",
                "index": {"kind": "explicit", "phase": 1.34, "group": 1.36},
                "absorption_per_m": 0.05,
                "scattering_per_m": scattering,
                "phase_function": {"kind": "henyey-greenstein", "g": g},
            },
            "rig.camera.rows": 4,
            "rig.camera.cols": 4,
            "rig.camera.focal_length_m": 2.5e-4,
            "rig.laser.position_m": [0.3, 0.0, 0.0],
            "rig.delays.start_s": 4.8 * 1.36 / C,
            "rig.delays.step_s": 0.25 * 1.36 / C,
            "rig.delays.count": 8,
        }
        | more,
    )


def remainder(scene: Scene, seed: int, samples: int, component: str = "all", **more: Any) -> Remainder:
    slices, camera = slices_of(scene), gated_rig(scene).camera
    nothing = np.zeros((len(slices.delay_s), camera.rows, camera.cols), dtype=np.float32)
    limits = Limits(most_samples=samples)
    return render_remainder(scene, nothing, slices, 1e-9, seed, 0, component=component, limits=limits, **more)
