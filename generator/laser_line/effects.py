"""The catalogue of effects of laser-line captures: what the `direct` rung models, what it leaves out, and how large that is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.water.phase_forms import phase_density
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.rigs.laser_line_geometry import line_sheet
from ...scenes.scene import Scene
from ..effect import Effect, effect, interreflection
from .expected import FrameLight

__all__ = ["catalogue", "scattered_sizes"]

Float = NDArray[np.float64]


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
        *(effect(name, rung != "direct", *line) for name, line in scattered_sizes(scene, light).items()),
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
    """{effect: (size, basis)} of scattered light, by closed forms.

    The curtain is the sheet's own light in the water before the target, scattered once: radiance
    β(ψ) P p(φ)/r e^{−c(r+s)}/sinθ, θ between ray and sheet; here over that of the line in its brightest pixel. The halo is
    bounded by all light that was scattered, e^{2br} − 1.
    """
    b = scene.medium.scattering_per_m
    names = ("curtain of scattered light", "forward-scattered halo", "multiple scattering")
    if b == 0:
        return dict.fromkeys(names, (0.0, "nothing scatters"))
    reached = _reached(scene, light)
    spread = float(np.expm1(min(2.0 * b * reached, 50.0)))
    halo = (spread, "e^(2br) − 1: all light that is scattered on its way, an upper bound")
    multiple = (min(0.5 * spread**2, 1e9), "half of the halo's square, an upper bound")
    if scene.medium.phase is None:
        unknown = (None, "needs the phase function")
        return dict(zip(names, (unknown, halo, multiple), strict=True))
    return dict(zip(names, (_curtain(scene, light, reached), halo, multiple), strict=True))


def _curtain(scene: Scene, light: FrameLight, reached: float) -> tuple[float | None, str]:
    """The brightest part of the curtain in the view, at half the range or nearer, over the line's brightest pixel."""
    rig = laser_line_rig(scene)
    phase, c, b = scene.medium.phase, scene.medium.attenuation_per_m, scene.medium.scattering_per_m
    assert phase is not None
    basis = "b β̃(ψ) e^(2c(r − r'))(r/r')/sinθ over ρ/π times the peak's share, nearest sheet in view"
    half = 0.5 * rig.camera.cols * rig.camera.pixel_pitch_m / rig.camera.focal_length_m
    sheet = line_sheet(rig, phase_index(scene.medium, rig.wavelength_m))
    axis = sheet.frame[:, 2]
    r = np.linspace(0.02, 1.0, 200) * reached
    point = sheet.source[:, None] + axis[:, None] * r
    s = np.linalg.norm(point, axis=0)
    seen = (point[2] > 0) & (np.abs(point[0]) <= half * point[2])
    if not seen.any() or light.peak <= 0:
        return None, "no part of the sheet is in view"
    view = point / s
    sine = np.abs(sheet.normal @ view)
    turned = np.pi - np.arccos(np.clip(-(axis @ view), -1.0, 1.0))
    radiance = b * phase_density(phase, np.pi - turned) * np.exp(-c * (r + s)) / (r * np.maximum(sine, 1e-3))
    matt = max(item.material.albedo_at_normal() for item in scene.target) / np.pi
    width = float(np.nanmedian(light.truth.width))
    sigma = float(sheet.sigma(reached))
    peak = matt * np.exp(-2.0 * c * reached) / reached / (np.sqrt(2.0 * np.pi) * sigma * max(1.0, 0.4 / width))
    return float(radiance[seen].max() / peak), basis


def _motion_blur_px(rig: LaserLineRig, reached: float) -> float:
    """Pixels that the line may move in an exposure."""
    speed = float(np.linalg.norm(rig.motion_m_per_s or (0.0, 0.0, 0.0))) / reached
    speed += float(np.linalg.norm(rig.turn_rad_per_s or (0.0, 0.0, 0.0)))
    return speed * rig.detector.exposure_s * rig.camera.focal_length_m / rig.camera.pixel_pitch_m
