"""The catalogue of effects of wavefront captures: what a rung models, what it leaves out, and how large that is."""

from __future__ import annotations

import numpy as np

from ...scenes.rigs.wavefront import WavefrontRig, wavefront_rig
from ...scenes.scene import Scene
from ..effect import Effect, effect
from .expected import Sensed
from .scintillation import irradiance_index

__all__ = ["catalogue"]

_WIDE = "width of a diffuse target's lit place"


def catalogue(scene: Scene, sensed: Sensed, rung: str) -> list[Effect]:
    """Every catalogued effect at the rung. Sizes are shares of the spots' light."""
    rig = wavefront_rig(scene)
    detector = rig.detector
    fields = rung != "geometric"
    looks = None if rig.effects is None else rig.effects.speckle_looks
    index = irradiance_index(sensed.rytov)
    cells, error = sensed.cells
    finer = [effect("phase finer than a lenslet's cells", False, error, f"a pilot with finer cells; {cells} a side")]
    moved = f"rms of a point's irradiance; Rytov's variance {sensed.rytov:.2g}"
    blur = float(-np.expm1(-(sensed.spread_rad**2)))
    listed = [
        effect("mean slope of each lenslet", True, 1.0, "spots moved by f times the slope"),
        effect("diffraction at the lenslets", True, None, "pattern of the clear square or hexagon, integrated over pixels"),
        effect("spots blurred by the phase within a lenslet", fields, blur, "1 − e^(−σ²), σ the phase's rms about its plane"),
        effect("light of neighbouring lenslets", True, None, "intensities added" if rung != "coherent" else "fields added"),
        effect("interference of neighbouring lenslets", rung == "coherent", None, "depends on the pistons of neighbours"),
        effect("scintillation", rig.propagation == "split-step", index**0.5, moved),
        effect("beam attenuation", True, None, "e^(−2cr)"),
        effect("scattered light in the gate", scene.medium.scattering_per_m > 0, None, "single scatter, even over the image"),
        effect("photon noise", True, None, "Poisson"),
        effect("excess noise of the tube", detector.intensifier is not None, None, "gamma"),
        effect("phosphor's point spread", bool(detector.intensifier and detector.intensifier.phosphor_sigma_px), None, "Gaussian"),
        effect("dark current", True, None, "Poisson"),
        effect("read noise", True, None, "Gaussian"),
        effect("PRNU", bool(detector.prnu), detector.prnu, "rms"),
        effect("DSNU", bool(detector.dsnu_e), None, "fixed offsets"),
        effect("lenslets that differ", False, None, "not modelled: all have one focal length and no aberration"),
        *_speckle(rig),
        *(effect(name, looks is not None and name == _WIDE, *size) for name, size in _diffuse_sizes(scene, rig).items()),
        *_pointing(rig),
    ]  # fmt: skip
    return listed + finer if fields else listed


def _pointing(rig: WavefrontRig) -> list[Effect]:
    jitter = None if rig.effects is None else rig.effects.pointing_jitter_rad
    return (
        []
        if jitter is None
        else [effect("pointing of the platform", True, None, f"{jitter:g} rad rms, from frame to frame")]
    )


def _speckle(rig: WavefrontRig) -> list[Effect]:
    name = "speckle of a diffuse target"
    if rig.reflection == "mirror":
        return [effect(name, False, 0.0, "a mirror sends back the beam")]
    looks = None if rig.effects is None else rig.effects.speckle_looks
    if looks is None:
        return [effect(name, False, None, "taken as averaged away")]
    return [effect(name, True, looks**-0.5, "contrast 1/√M at a point of the array")]


def _diffuse_sizes(scene: Scene, rig: WavefrontRig) -> dict[str, tuple[float | None, str]]:
    """What a diffuse target adds to a point at infinity, each in pixels of a spot: the curvature of its wave, the slope D/2r at the
    edge of the pupil D, and the width of the lit place, beam over range."""
    curved, wide = "curvature of a diffuse target's wave", _WIDE
    if rig.reflection == "mirror" or not scene.target:
        return dict.fromkeys((curved, wide), (0.0, "a mirror sends back the beam"))
    away = min(float(item.shape.center_m[2]) for item in scene.target)
    per_rad = rig.lenslets.focal_length_m / rig.camera.pixel_pitch_m
    beam = rig.bench.beam_diameter_m / rig.bench.magnification
    # The bench magnifies lengths by M and angles by 1/M.
    edge = 0.5 * rig.pupil.diameter_m / rig.bench.magnification / away / rig.bench.magnification
    return {
        curved: (per_rad * edge, "pixels, at the pupil's edge"),
        wide: (per_rad * beam / away / rig.bench.magnification, "pixels, the lit place's full width"),
    }
