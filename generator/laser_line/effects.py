"""The catalogue of effects of laser-line captures: what a rung models, what it leaves out, and how large that is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.scene import Scene
from ..effect import Effect, effect, interreflection
from .expected import FrameLight

__all__ = ["SCATTERED", "catalogue", "scattered_sizes"]

Float = NDArray[np.float64]

#: Effects of scattered light: the first two are what the rung `scatter` adds.
SCATTERED = ("curtain of scattered light", "forward-scattered halo", "multiple scattering")


def catalogue(scene: Scene, light: FrameLight, rung: str = "direct") -> list[Effect]:
    """Every catalogued effect at the rung."""
    rig = laser_line_rig(scene)
    detector = rig.detector
    reached = _reached(scene, light)
    through = float(-np.expm1(-2.0 * scene.medium.attenuation_per_m * reached))
    blur = _motion_blur_px(rig, reached)
    return [
        effect("first bounce", True, 1.0, "first hits, sheet's profile integrated over pixels"),
        effect("refraction at the port", rig.port.kind == "flat", None, "exact, both ways"),
        effect("beam attenuation", True, through, "1 − e^(−2cr)"),
        *(
            effect(name, rung != "direct" and name != SCATTERED[2], *line)
            for name, line in scattered_sizes(scene, light).items()
        ),
        effect("interreflection", False, *interreflection(scene)),
        effect("occlusion of laser and camera", True, None, "shadow rays to the laser's place"),
        effect("lens point spread", rig.lens_sigma_px > 0, None, "Gaussian, along the rows"),
        effect("lens point spread across edges", False, 0.0 if rig.lens_sigma_px == 0 else None, "not modelled"),
        effect("light reflected inside the port", False, 0.0 if rig.port.kind == "none" else None, "not modelled"),
        effect("motion blur", False, blur, "pixels moved in an exposure over the line's width"),
        effect("speckle", False, None, "not modelled; contrast 1/√M"),
        effect("photon noise", True, None, "Poisson"),
        effect("dark current", True, None, "Poisson"),
        effect("read noise", True, None, "Gaussian"),
        effect("PRNU", bool(detector.prnu), detector.prnu, "rms"),
        effect("DSNU", bool(detector.dsnu_e), None, "fixed offsets"),
        effect("blooming", False, None, "not modelled"),
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
    the rung `scatter` leaves out: light that is scattered again on the curtain's way, up to e^{2br(1−B)} − 1 of it, and a
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


def _motion_blur_px(rig: LaserLineRig, reached: float) -> float:
    """Pixels that the line may move in an exposure."""
    speed = float(np.linalg.norm(rig.motion_m_per_s or (0.0, 0.0, 0.0))) / reached
    speed += float(np.linalg.norm(rig.turn_rad_per_s or (0.0, 0.0, 0.0)))
    return speed * rig.detector.exposure_s * rig.camera.focal_length_m / rig.camera.pixel_pitch_m
