"""The catalogue of effects of laser-line captures: what a rung models, what it leaves out, and how large that is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_effects import LineEffects
from ...scenes.rigs.laser_line_geometry import line_camera
from ...scenes.scene import Scene
from ..effect import Effect, effect, interreflection
from .expected import FrameLight

__all__ = ["EVEN_SCATTERED", "MOTION", "SCATTERED", "catalogue", "motion_blur", "scattered_sizes"]

Float = NDArray[np.float64]

#: Effects of scattered light: the first two are what the rung `scatter` adds.
MOTION = "motion blur"
EVEN_SCATTERED = "scattered even light"
_DEFOCUS = "disc of second moment D²/16 as a Gaussian, along the rows; of line and traced light, not of curtain, halo, even light"
SCATTERED = ("curtain of scattered light", "forward-scattered halo", "multiple scattering")


def catalogue(scene: Scene, light: FrameLight, rung: str = "direct") -> list[Effect]:
    """Every catalogued effect at the rung."""
    rig = laser_line_rig(scene)
    detector = rig.detector
    made = rig.effects or LineEffects()
    focus, looks = made.focus is not None, made.speckle_looks
    reached = _reached(scene, light)
    through = float(-np.expm1(-2.0 * scene.medium.attenuation_per_m * reached))
    return [
        effect("first bounce", True, 1.0, "first hits, sheet's profile integrated over pixels"),
        effect("refraction at the port", rig.port.kind != "none", None, "exact, both ways"),
        effect("beam attenuation", True, through, "1 − e^(−2cr)"),
        *(
            effect(name, rung == "full" or (rung != "direct" and name != SCATTERED[2]), *line)
            for name, line in scattered_sizes(scene, light).items()
        ),
        effect("interreflection", rung == "full", *interreflection(scene)),
        effect("occlusion of laser and camera", True, None, "shadow rays to the laser's place"),
        effect(
            EVEN_SCATTERED,
            False,
            None if rig.even_light_e_per_s and scene.medium.scattering_per_m > 0 else 0.0,
            "even light reaches the camera straight",
        ),
        effect("lens point spread", rig.lens_sigma_px > 0, None, "Gaussian, along the rows"),
        effect("lens point spread across edges", False, 0.0 if rig.lens_sigma_px == 0 else None, "not modelled"),
        effect("light reflected inside the port", False, 0.0 if rig.port.kind == "none" else None, "not modelled"),
        effect("defocus", focus, None if focus else 0.0, _DEFOCUS),
        effect(
            MOTION,
            made.exposure_poses is not None,
            motion_blur(scene, light),
            "√3 L²/48s² of the profile, L moved in an exposure, s the width",
        ),
        effect("speckle", looks is not None, None if looks is None else looks**-0.5, "contrast 1/√M, by pixel"),
        effect("photon noise", True, None, "Poisson"),
        effect("dark current", True, None, "Poisson"),
        effect("read noise", True, None, "Gaussian"),
        effect("PRNU", bool(detector.prnu), detector.prnu, "rms"),
        effect("DSNU", bool(detector.dsnu_e), None, "fixed offsets"),
        effect("blooming", made.blooming is not None, None, "charge beyond the full well spills to neighbours"),
    ]


def _reached(scene: Scene, light: FrameLight) -> float:
    """Median distance [m] of the line from the camera; that of the target where there is no line."""
    distance = np.linalg.norm(light.truth.point, axis=-1)
    if np.isfinite(distance).any():
        return float(np.nanmedian(distance))
    return max(float(np.median([abs(item.shape.center_m[2]) for item in scene.target])), 1e-3)


def scattered_sizes(scene: Scene, light: FrameLight) -> dict[str, tuple[float | None, str]]:
    """{effect: (size, basis)} of scattered light: root mean squares over the image, relative to the line's.

    Without a phase function the curtain is unknown, and the halo is bounded by all light that was scattered, e^{2br} − 1. What
    the rung `scatter` leaves out: light that is scattered again on the curtain's way, up to e^{2br} − 1 of it, and a
    sixth of the halo, by which paths traced in full exceed the small-angle picture at most.
    """
    b, reached = scene.medium.scattering_per_m, _reached(scene, light)
    if b == 0:
        return dict.fromkeys(SCATTERED, (0.0, "nothing scatters"))
    again = float(np.expm1(min(2.0 * b * reached, 50.0)))
    if light.scattered is None or not light.line.any():
        unknown = (None, "needs the phase function and a line")
        return dict(zip(SCATTERED, (unknown, (again, "e^(2br) − 1, an upper bound"), unknown), strict=True))
    whole = _rms(light.line)
    veil, halo = _rms(light.scattered.curtain) / whole, _rms(light.scattered.halo) / whole
    rest = veil * again + halo / 6.0
    basis = "rms over the image, relative to the line's"
    return dict(
        zip(SCATTERED, ((veil, basis), (halo, basis), (rest, "upper bound from curtain and halo")), strict=True)
    )


def _rms(image: Float) -> float:
    return float(np.sqrt(np.mean(np.asarray(image, np.float64) ** 2)))


def motion_blur(scene: Scene, light: FrameLight) -> float:
    """Change of the line's profile by motion within an exposure, rms over rms, at most 1: √3 L²/(48 s²).

    Light that is spread evenly over L adds L²/12 to s², and ‖∂G/∂s²‖/‖G‖ = √3/(4 s²) for a Gaussian. L is the way across the
    image of a point at the line's range that moves square to the view.
    """
    rig = laser_line_rig(scene)
    speed = float(np.linalg.norm(rig.motion_m_per_s or (0.0, 0.0, 0.0))) / _reached(scene, light)
    speed += float(np.linalg.norm(rig.turn_rad_per_s or (0.0, 0.0, 0.0)))
    if speed == 0.0:
        return 0.0
    per_rad = rig.camera.focal_length_m / rig.camera.pixel_pitch_m
    per_rad *= line_camera(rig, phase_index(scene.medium, rig.wavelength_m)).narrowing
    width = light.truth.width[np.isfinite(light.truth.width)]
    if not width.size:
        return 1.0
    return float(min(np.sqrt(3.0) / 48.0 * (speed * rig.detector.exposure_s * per_rad / np.median(width)) ** 2, 1.0))
