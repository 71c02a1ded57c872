"""The wavefront rig: a Shack-Hartmann sensor behind a gate, and the beam whose echo it reads.

The camera looks along +z; lenslets, pixels and the scene share x (right) and y (down). A positive slope ∂W/∂x moves a spot to
larger columns, ∂W/∂y to larger rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...optics.correlation.waveforms import gate_area, sample_gate
from ...optics.lenslets.hexagons import hexagon_density
from ..base import Vec3
from ..errors import InputError
from ..medium_index import medium_data
from ..sampling import optics_gate
from .declaring import as_declared
from .kind import RigKind, RigScene, RigView, rig_of
from .parts import Camera, Illumination
from .wavefront_geometry import Lattice, lattice_of, spot_px
from .wavefront_spec import WavefrontRig

__all__ = ["KIND", "WavefrontRig", "wavefront_rig"]

#: Samples of the declared spot per pixel, and its half width in pitches.
_PER_PX, _REACH = 16, 3.5
#: Narrowest spot of a hexagon, λf/d in pixels: the table of a narrower one would have millions of nodes.
_NARROWEST_PX = 0.2
#: Samples of the gate from which its centroid follows.
_PER_GATE = 1024


def wavefront_rig(scene: RigScene) -> WavefrontRig:
    """The scene's rig, which must be a wavefront rig. Raises InputError for a scene of another modality."""
    return rig_of(scene, WavefrontRig)


def _declare(scene: RigScene) -> dict[str, Any]:
    rig, medium = as_declared(scene, WavefrontRig)
    lattice = lattice_of(rig)
    return {
        "schema": 1,
        "kind": rig.kind,
        "laser": {"wavelength_m": rig.wavelength_m},
        "bench": rig.bench.model_dump(mode="json"),
        "lenslets": {
            "pitch_m": rig.lenslets.pitch_m,
            "focal_length_m": rig.lenslets.focal_length_m,
            **({"grid": "hexagonal"} if rig.lenslets.hexagonal else {}),
            "rotation_rad": lattice.rotation_rad,
            "row": lattice.row.tolist(),
            "col": lattice.col.tolist(),
            "x_m": _rounded(lattice.x_m),
            "y_m": _rounded(lattice.y_m),
            "row_px": _rounded(lattice.row_px),
            "col_px": _rounded(lattice.col_px),
        },
        "pupil": {
            "shape": rig.pupil.shape,
            "diameter_m": rig.pupil.diameter_m,
            "samples": len(lattice.grid_m),
            "step_m": lattice.step_m,
            "modes": rig.pupil.modes,
        },
        "camera": rig.camera.model_dump(mode="json"),
        "spot": _spot(rig),
        "detector": rig.detector.model_dump(mode="json", exclude={"fixed_pattern_seed"}),
        "reference": {"exposures": rig.frames.reference_exposures},
        "reflection": rig.reflection,
        "gate": {"centre_s": _gate_centre_s(rig)},
        "medium": medium_data(medium, rig.wavelength_m),
        "t0_s": rig.t0_s,
        **({} if rig.imager is None else {"imager": rig.imager.model_dump(mode="json")}),
    }


def _gate_centre_s(rig: WavefrontRig) -> float:
    """Centroid of the gate's transmission after its opening half-height edge [s]."""
    gate = optics_gate(rig.gate)
    start, value = sample_gate(gate, gate_area(gate) / _PER_GATE)
    at = start + gate_area(gate) / _PER_GATE * np.arange(value.size)
    return float(f"{float((at * value).sum() / value.sum()):.9g}")


def _rounded(values: Any) -> list[float]:
    """Twelve digits: a millionth of a pixel, and short in JSON."""
    return [float(f"{value:.12g}") for value in np.asarray(values)]


def _spot(rig: WavefrontRig) -> dict[str, Any]:
    """The spot of a flat wavefront along x, and along y, before pixels: (1/w) sinc²(u/w), w = λf/d, and the tube's phosphor.

    Of a hexagon, whose spot is no product, the mean of its sections along both axes.
    """
    width = spot_px(rig)
    reach = int(np.ceil(_REACH * rig.lenslets.pitch_m / rig.camera.pixel_pitch_m * _PER_PX))
    u = np.arange(-reach, reach + 1) / _PER_PX
    value = np.sinc(u / width) ** 2 / width
    if rig.lenslets.hexagonal:
        value = 0.5 * (hexagon_density(u / width, 0.0) + hexagon_density(0.0, u / width))
        value /= value.sum() / _PER_PX
    tube = rig.detector.intensifier
    if tube is not None and tube.phosphor_sigma_px > 0:
        from scipy.ndimage import gaussian_filter1d

        value = gaussian_filter1d(value, tube.phosphor_sigma_px * _PER_PX, mode="constant", truncate=6.0)
    return {"start_px": float(u[0]), "step_px": 1.0 / _PER_PX, "value": [float(f"{v:.9g}") for v in value]}


def _check(scene: RigScene) -> None:
    """Refuse lenslets outside the image, an empty pupil, cells of few pixels, and targets that send no beam back."""
    rig = wavefront_rig(scene)
    lattice = lattice_of(rig)
    array, camera = rig.lenslets, rig.camera
    for site in array.missing:
        if max(site) >= array.across:
            raise InputError(
                "A missing lenslet lies outside the array.", where=f"{scene.name}: rig.lenslets.missing", value=list(site),
                allowed=f"rows and columns 0 to {array.across - 1}",
            )  # fmt: skip
    if not lattice.row.size:
        raise InputError(
            "No lenslet lies in the pupil.", where=f"{scene.name}: rig.pupil", value=rig.pupil.diameter_m,
            allowed=f"a pupil that holds {rig.pupil.least_fill:g} of a lenslet of {array.pitch_m:g} m",
            next_step="widen rig.pupil.diameter_m, or lower rig.pupil.least_fill",
        )  # fmt: skip
    if not lattice.open.any():
        # Half of a sample must lie in the clear hexagon, and the middle of one in the clear square.
        least = (2.0 if array.hexagonal else 1.0) / array.fill
        raise InputError(
            "No sample of the pupil lies in a lenslet's clear area.", where=f"{scene.name}: rig.pupil.samples",
            value=rig.pupil.samples, allowed=f"{int(np.ceil(least))} or more at a fill of {array.fill:g}",
            next_step="raise rig.pupil.samples",
        )  # fmt: skip
    cell = array.pitch_m / camera.pixel_pitch_m
    if cell < 3.0:
        raise InputError(
            "A lenslet covers too few pixels for the position of its spot.", where=f"{scene.name}: rig.camera.pixel_pitch_m",
            value=f"{cell:.3g} pixels", allowed="3 pixels or more",
        )  # fmt: skip
    width = spot_px(rig)
    if array.hexagonal and width < _NARROWEST_PX:
        raise InputError(
            "The spots of hexagonal lenslets are narrower than their table resolves.", where=f"{scene.name}: rig.lenslets",
            value=f"λf/d = {width:.3g} pixels", allowed=f"{_NARROWEST_PX:g} pixels or more",
            next_step="smaller pixels or lenslets, a longer focal length, or a square grid",
        )  # fmt: skip
    _check_image(scene, rig, lattice, cell)
    _check_targets(scene, rig)


def _check_image(scene: RigScene, rig: WavefrontRig, lattice: Lattice, cell: float) -> None:
    for name, at, size in (("cols", lattice.col_px, rig.camera.cols), ("rows", lattice.row_px, rig.camera.rows)):
        low, high = float(at.min() - 0.5 * cell), float(at.max() + 0.5 * cell)
        if low < -0.5 or high > size - 0.5:
            raise InputError(
                "Cells of used lenslets lie outside the image.", where=f"{scene.name}: rig.camera.{name}",
                value=f"cells from {low:.4g} to {high:.4g} px", allowed=f"-0.5 to {size - 0.5:g} px",
                next_step=f"raise rig.camera.{name}, or lower rig.pupil.diameter_m or the array's offset",
            )  # fmt: skip
    if rig.pupil.diameter_m > rig.bench.beam_diameter_m:
        raise InputError(
            "The beam does not fill the pupil.", where=f"{scene.name}: rig.bench.beam_diameter_m",
            value=rig.bench.beam_diameter_m, allowed=f"{rig.pupil.diameter_m:g} m or more",
        )  # fmt: skip


def _check_targets(scene: RigScene, rig: WavefrontRig) -> None:
    if rig.reflection == "mirror" and rig.effects is not None and rig.effects.speckle_looks is not None:
        raise InputError(
            "The light of a mirror has no speckle.", where=f"{scene.name}: rig.effects.speckle_looks",
            value=rig.effects.speckle_looks, allowed='null, or a target of rig.reflection = "diffuse"',
        )  # fmt: skip
    for item in getattr(scene, "target", ()):
        shape = item.shape
        flat = shape.kind == "rectangle" and shape.tilt_x_deg == 0 and shape.tilt_y_deg == 0
        if not flat or shape.center_m[2] <= 0:
            raise InputError(
                "The beam of a wavefront rig meets flat reflectors square to it only.",
                where=f"{scene.name}: target.{item.name}.shape", value=shape.model_dump(mode="json"),
                allowed="a rectangle at z > 0 without tilt",
            )  # fmt: skip
        half = 0.5 * rig.bench.beam_diameter_m / rig.bench.magnification
        reach = min(0.5 * shape.width_m - abs(shape.center_m[0]), 0.5 * shape.height_m - abs(shape.center_m[1]))
        if reach < half:
            raise InputError(
                "A reflector does not cover the beam.", where=f"{scene.name}: target.{item.name}.shape", value=reach,
                allowed=f"{half:.4g} m or more from the axis to every edge",
            )  # fmt: skip


def _sizes(rig: WavefrontRig) -> tuple[int, int, int]:
    return rig.camera.rows * rig.camera.cols, rig.frames.count, 1


def _places(rig: WavefrontRig) -> dict[str, Vec3]:
    return {"camera": (0.0, 0.0, 0.0)}


def _view(rig: WavefrontRig) -> RigView:
    """For pictures: the beam's narrow cone, seen through the collimator by the pixels that the lenslets stand before."""
    cone = Illumination(profile="flat-top", half_angle_rad=1e-3, offset_rad=(0.0, 0.0))
    focal = rig.bench.collimator_focal_length_m
    camera = Camera(
        rows=rig.camera.rows, cols=rig.camera.cols, pixel_pitch_m=rig.camera.pixel_pitch_m, focal_length_m=focal,
        f_number=min(max(focal / rig.bench.beam_diameter_m, 0.1), 1e6), transmission=1.0,
        quantum_efficiency=rig.camera.quantum_efficiency, vignetting="none",
    )  # fmt: skip
    return RigView(camera, cone)


def _resize(side: int) -> dict[str, Any]:
    # A frame holds as many spots as the array has lenslets, some hundreds: a few frames are as many elements as side × side pixels.
    return {"rig.frames.count": max(side // 6, 1)}


KIND = RigKind(
    "wavefront",
    WavefrontRig,
    declare=_declare,
    check=_check,
    sizes=_sizes,
    places=_places,
    view=_view,
    resize=_resize,
    roles={
        "ambient": "rig.ambient_e_per_s",
        "fluctuation": "rig.laser.energy_fluctuation",
        "full-well": "rig.detector.full_well_e",
        "gain": "rig.detector.gain_dn_per_e",
        "jitter": "rig.laser.jitter_frame_s",
        "light": "rig.laser.pulse_energy_j",
        "pitch": "rig.lenslets.pitch_m",
        "phosphor": "rig.detector.intensifier.phosphor_sigma_px",
        "pulse": "rig.laser.pulse",
        "pulse-width": "rig.laser.pulse.fwhm_s",
        "read-noise": "rig.detector.read_noise_e",
        "start": "rig.frames.start_s",
    },
)
