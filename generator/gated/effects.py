"""The catalogue of effects: what the `direct` rung models, what it neglects, and how large that is predicted to be.

Sizes are relative to the signal, by closed forms; None where no bound is known for this scene.
"""

from __future__ import annotations

import numpy as np

from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..effect import Effect, effect, interreflection
from ..rays.returns import depth_of_pixels
from . import scatter_size
from .direct import DirectScene
from .finite_size import finite_size

__all__ = ["catalogue"]


def catalogue(scene: Scene, direct: DirectScene, rung: str = "direct") -> list[Effect]:
    """Every catalogued effect of a gated capture at the rung."""
    rig = gated_rig(scene)
    distance = direct.truth["truth_range"]
    typical = float(np.nanmedian(distance)) if np.isfinite(distance).any() else 0.0
    detector, laser, tube = rig.detector, rig.laser, rig.detector.intensifier

    return [
        effect("first bounce", True, 1.0, "Mitsuba first hits, exact times"),
        effect("sub-pixel mixtures", True, None, "adaptive sub-pixel rays"),
        effect(
            "beam attenuation", True, float(-np.expm1(-2 * scene.medium.attenuation_per_m * typical)), "1 − e^(−2cr)"
        ),
        effect("group index", True, None, "all times at c/n_g"),
        *(effect(*line) for line in _scattering(scene, direct, typical, rung)),
        effect("interreflection", rung == "full", *interreflection(scene)),
        effect("finite source and aperture", rung == "full", *finite_size(scene, direct)),
        effect("lens point spread", False, None, "pinhole"),
        effect("pulse energy fluctuation", bool(laser.energy_fluctuation), laser.energy_fluctuation, "rms per slice"),
        effect(
            "jitter of single shots", bool(laser.jitter_shot_s), None, "broadens R and moves the mean delay of a slice"
        ),
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
        effect("motion between slices", *_motion(scene)),
        effect(
            "a second surface in every pixel", rig.screen is not None, 0.0 if rig.screen is None else None, "screen"
        ),
    ]


def _motion(scene: Scene) -> tuple[bool, float, str]:
    """Whether the rig moves, and the displacement over the capture over the range."""
    rig = gated_rig(scene)
    if rig.motion_m_per_s is None:
        return False, 0.0, "scene and rig are still"
    slices = len(rig.gates) * rig.delays.count * rig.delays.repeats + rig.delays.laser_off
    travel = float(np.linalg.norm(rig.motion_m_per_s)) * slices * rig.detector.exposure_s
    nearest = min(item.shape.center_m[2] for item in scene.target)
    return True, travel / nearest, "displacement over the capture relative to the target's distance"


def _scattering(
    scene: Scene, direct: DirectScene, typical: float, rung: str
) -> list[tuple[str, bool, float | None, str]]:
    """Effects of a scattering medium at the typical range, whether the rung models them, and how large they are."""
    b = scene.medium.scattering_per_m
    phase = scene.medium.phase
    there = rung != "direct"
    if b == 0 or typical == 0 or phase is None:
        forward = float(np.expm1(min(2 * b * typical, 50.0)))
        size, basis = (0.0, "nothing scatters") if b == 0 else (None, "needs the phase function")
        return [
            ("forward-scattered light", there, forward, "e^(2br) − 1, wide beam"),
            ("volume backscatter", there, size, basis),
            ("halo from outside the view", rung == "full", size, basis),
            ("delay of scattered light", there, size, basis),
            ("multiple scattering", rung == "full", size, basis),
        ]
    amplitude = np.asarray(direct.truth["truth_amplitude"])
    lit = amplitude[amplitude > 0]
    middle = float(np.median(lit)) if lit.size else 0.0
    back = scatter_size.backscatter_size(scene, phase, typical, middle, rung == "scatter")
    delay = scatter_size.delay_size(scene, phase, typical, depth_of_pixels(direct.returns))
    return [
        (
            "forward-scattered light", there, scatter_size.forward_size(scene, phase, typical),
            "(1 + X(0)/I(0)) e^(br(1 − B)) − 1, on the beam's axis",
        ),
        (
            "volume backscatter", there, back if np.isfinite(back) else None,
            "single scattering, largest slice over the target's largest",
        ),
        (
            "halo from outside the view", rung == "full", scatter_size.outside_size(scene, phase, typical),
            "halo from beyond the widened image, of all light; rms over the image",
        ),
        ("delay of scattered light", there, delay, "rms over slices of the echo with against without it"),
        ("multiple scattering", rung == "full", scatter_size.multiple_size(delay), "half the delay's size"),
    ]  # fmt: skip
