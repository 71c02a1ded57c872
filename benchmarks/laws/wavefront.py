"""What the laws run on for wavefronts: 48 frames of bright spots behind 4 × 4 lenslets."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.deconvolution import blurred_eq31, point_spread, transfer_of
from ...optics.lenslets.gradients import mean_gradients, square
from ...optics.turbulence.slopes import gradient_covariance
from ...optics.turbulence.strength import kolmogorov_structure
from ...optics.zernike import zernike
from ...scenes.load import load_scene
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import lattice_of
from ...scenes.scene import Scene
from ..written.wavefront import written_capture
from .maker import Laws

__all__ = ["LAWS", "clean_capture", "imaged_capture", "turbulent_capture"]

_FRAMES, _ELECTRONS, _BACKGROUND = 48, 1.5e3, 2.0
#: Greatest Noll index of the wavefront, and how far it moves the spots, rms.
_MODES, _PIXELS = 6, 0.1
#: Fried's parameter of the turbulent capture, twice the pupil: it moves the spots by .2 px rms.
_R0_M = 1.5e-3
#: Pixels by which the camera is moved.
_SHIFT = 2
#: Side and black border [px] of the image, and photoelectrons of a white pixel.
_IMAGE, _EDGE, _WHITE = 16, 4, 1e4

Float = npt.NDArray[np.float64]


def clean_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """48 frames of 4 × 4 lenslets, 1,500 photoelectrons each, moved by .1 px rms by slopes of the modes that are fitted.

    A converter of 12 bits, and an offset well above the noise, so that a count of 0 is a dead pixel.
    """
    scene = _scene()
    coefficient, slope = _waves(scene)
    capture = written_capture(scene, light * _ELECTRONS, background * _BACKGROUND, slope, seed=seed)
    return capture.assign(truth_zernike=capture["truth_zernike"].copy(data=coefficient))


def imaged_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """`clean_capture` with what a camera of 16 × 16 pixels sees through the same waves: a white square."""
    scene = _scene()
    capture = clean_capture(seed, light, background)
    lattice, radius = lattice_of(wavefront_rig(scene)), 0.5 * wavefront_rig(scene).pupil.diameter_m
    x, y = np.broadcast_arrays(lattice.grid_m[None, :] / radius, lattice.grid_m[:, None] / radius)
    modes = zernike(range(2, _MODES + 1), x, y)
    white = light * _WHITE
    wide = np.zeros((2 * _IMAGE, 2 * _IMAGE))
    wide[_EDGE : _IMAGE - _EDGE, _EDGE : _IMAGE - _EDGE] = white
    drawn, rng = np.empty((_FRAMES, _IMAGE, _IMAGE)), np.random.default_rng(seed)
    for frame, coefficient in enumerate(_waves(scene)[0]):
        spread = point_spread(np.tensordot(coefficient, modes, axes=1), lattice.mask.astype(np.float64))
        mean = blurred_eq31(wide, transfer_of(spread, wide.shape))[:_IMAGE, :_IMAGE]
        drawn[frame] = rng.poisson(np.maximum(mean, 0.0))
    rig = json.loads(capture.attrs["rig"]) | {"imager": {"side": _IMAGE, "photoelectrons": white, "read_noise_e": 0.0}}
    attributes = {"units": "electron", "long_name": "chart seen through the same pupil"}
    image = (("frame", "image_row", "image_col"), drawn, attributes)
    told = {"units": "1", "long_name": "the chart, 1 where it is white"}
    chart = (("image_row", "image_col"), wide[:_IMAGE, :_IMAGE] / white, told)
    return capture.assign(image=image, truth_image=chart).assign_attrs(rig=json.dumps(rig))


def turbulent_capture(seed: int = 1, light: float = 1.0, background: float = 1.0) -> xr.Dataset:
    """`clean_capture` behind Kolmogorov's turbulence of r0 = 1.5 mm: slopes drawn from their covariance, new ones for each seed."""
    scene = _scene()
    rig = wavefront_rig(scene)
    lattice, k = lattice_of(rig), 2.0 * np.pi / rig.wavelength_m
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    covariance = gradient_covariance(lambda r: kolmogorov_structure(r, _R0_M), centre, rig.lenslets.pitch_m) / k**2
    rng = np.random.default_rng(1000 + seed)
    slope = rng.multivariate_normal(np.zeros(len(covariance)), covariance, _FRAMES).reshape(_FRAMES, -1, 2)
    capture = written_capture(scene, light * _ELECTRONS, background * _BACKGROUND, slope, seed=seed)
    truth = {"r0": (_R0_M, "m"), "present": (1.0, "1")}
    return capture.assign(
        {f"truth_{name}": (("gate",), np.array([value]), {"units": unit}) for name, (value, unit) in truth.items()}
    )


def _scene() -> Scene:
    return load_scene(
        "gated-turbulence",
        {
            "rig.lenslets.across": 4, "rig.pupil.diameter_m": 0.75e-3, "rig.pupil.modes": _MODES, "rig.pupil.least_fill": 0.6,
            "rig.pupil.samples": 4, "rig.camera.rows": 48, "rig.camera.cols": 48, "rig.frames.count": _FRAMES,
            "rig.detector.intensifier": None, "rig.detector.gain_dn_per_e": 2.0, "rig.detector.read_noise_e": 5.0,
            "rig.detector.dark_current_e_per_s": 0.0,
        },
    )  # fmt: skip


def _waves(scene: Scene) -> tuple[Float, Float]:
    """(Zernike coefficients [rad rms] (frame, mode), slopes [rad] (frame, lenslet, axis)) of 48 random waves."""
    rig = wavefront_rig(scene)
    lattice, radius = lattice_of(rig), 0.5 * rig.pupil.diameter_m
    centre = np.stack([lattice.x_m, lattice.y_m], axis=1)
    gradient = mean_gradients(range(2, _MODES + 1), centre, square(rig.lenslets.pitch_m), radius)
    coefficient = np.random.default_rng(7).standard_normal((_FRAMES, _MODES - 1))
    slope = np.einsum("laj,fj->fla", gradient, coefficient) * rig.wavelength_m / (2.0 * np.pi)
    size = _PIXELS * _slope_step(None) / slope.std()
    return coefficient * size, slope * size


def _later(capture: xr.Dataset) -> tuple[xr.Dataset, float]:
    """The camera moved by whole pixels behind the lenslets: all images, and where the rig declares their spots."""
    rig = json.loads(capture.attrs["rig"])
    for name in ("row_px", "col_px"):
        rig["lenslets"][name] = [value + _SHIFT for value in rig["lenslets"][name]]
    moved = {name: capture[name].roll(row=_SHIFT, col=_SHIFT) for name in ("counts", "reference")}
    return capture.assign(moved).assign_attrs(rig=json.dumps(rig)), float(_SHIFT)


def _step(capture: xr.Dataset) -> float:
    return 1.0


def _slope_step(capture: xr.Dataset | None) -> float:
    """Slope of a pixel, p/f."""
    return 17.8e-6 / 6.7e-3


def _mode_step(capture: xr.Dataset) -> float:
    """Tilt coefficient [rad rms] of a slope of a pixel: k s D/4."""
    return 2.0 * np.pi / 532e-9 * 17.8e-6 / 6.7e-3 * 0.75e-3 / 4.0


def _r0_step(capture: xr.Dataset) -> float:
    """A spot moved by a pixel more or less in every frame may change r0 by its own size."""
    return 1e-3


def _image_step(capture: xr.Dataset) -> float:
    """White."""
    return 1.0


def _converter(rig: dict[str, Any]) -> dict[str, Any]:
    part: dict[str, Any] = rig["detector"]
    return part


LAWS = Laws(
    (clean_capture,), "camera and declared lenslets moved by whole pixels, spots moved as far", _later, _step, _converter,
    {"assignment": _slope_step, "reconstruction": _mode_step, "turbulence": _r0_step, "deconvolution": _image_step},
    {"deconvolution": (imaged_capture,), "turbulence": (turbulent_capture,)},
)  # fmt: skip
