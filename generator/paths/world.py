"""A scene as the path tracer sees it: Mitsuba's geometry with our BSDFs, the lamp, the medium, the camera's factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...optics import illumination, ladar
from ...scenes.errors import InputError
from ...scenes.materials import Material
from ...scenes.medium_index import group_index
from ...scenes.meshes import shape_mesh
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere
from ..bsdf.lobes import opaque
from ..bsdf.plugin import mitsuba_bsdf
from ..bsdf.texture import shade_of, sphere_frame, vertex_uv
from ..rays.backend import mitsuba
from .phase import PhaseCells, phase_cells_of

__all__ = ["Lamp", "PathWorld"]

#: A law may return this share more than it gets, at grazing angles, before it is refused.
_ENERGY_SLACK = 1e-3


@dataclass(frozen=True)
class Lamp:
    """The laser as a point with a radiant intensity I(θ) [1/sr] per unit energy, about `axis`."""

    position: Any
    axis: Any
    profile: str
    half_angle: Any
    scale: Any
    values: Any
    cells: int

    @staticmethod
    def of(scene: Scene) -> Lamp:
        """The lamp of a scene."""
        mi = mitsuba()
        laser = gated_rig(scene).laser
        spec = laser.illumination
        w = spec.half_angle_rad
        values, cells, scale = [0.0, 0.0], 1, 0.0
        if spec.profile == "gaussian":
            scale = float(illumination.gaussian_intensity(0.0, w))
        elif spec.profile == "flat-top":
            scale = float(illumination.flat_top_intensity(0.0, w))
        else:
            assert spec.radial_value is not None
            cells = len(spec.radial_value) - 1
            grid = np.linspace(0.0, w, cells + 1)
            values = [float(v) for v in illumination.measured_intensity(grid, w, np.asarray(spec.radial_value))]
        axis = illumination.beam_axis(spec.offset_rad)
        return Lamp(
            mi.Point3f(*(opaque(float(p)) for p in laser.position_m)),
            mi.Vector3f(*(opaque(float(a)) for a in axis)),
            spec.profile,
            opaque(w),
            opaque(scale),
            mi.Float(values),
            cells,
        )

    def intensity(self, direction: Any) -> Any:
        """I(θ) along unit directions away from the lamp."""
        import drjit as dr

        theta = dr.atan2(dr.norm(dr.cross(self.axis, direction)), dr.dot(self.axis, direction))
        if self.profile == "gaussian":
            value = self.scale * dr.exp(-2.0 * dr.square(theta / self.half_angle))
            return dr.select(theta <= 0.5 * dr.pi, value, 0.0)
        if self.profile == "flat-top":
            return dr.select(theta <= self.half_angle, self.scale, 0.0)
        mi = mitsuba()
        inside = theta <= self.half_angle
        x = dr.minimum(theta / self.half_angle * self.cells, float(self.cells))
        left = dr.minimum(mi.UInt32(x), self.cells - 1)
        a = dr.gather(mi.Float, self.values, left, inside)
        b = dr.gather(mi.Float, self.values, left + 1, inside)
        return dr.select(inside, a + (x - mi.Float(left)) * (b - a), 0.0)


@dataclass(frozen=True)
class PathWorld:
    """All that the loop needs. `electrons`: photoelectrons of a slice per unit of radiance that a unit of emitted energy
    gives on the axis; `attenuation`, `absorption`, `scattering` 1/m; `phase` None where nothing scatters; `focus_distance` m
    None where all is sharp; `coaxial`: whether lamp and camera are at one point."""

    geometry: Any
    lamp: Lamp
    phase: PhaseCells | None
    attenuation: Any
    absorption: Any
    scattering: Any
    group_index: float
    electrons: float
    rows: int
    cols: int
    pitch_over_focal: float
    vignetting: bool
    aperture_radius: float = 0.0
    focus_distance: float | None = None
    source_radius: float = 0.0
    coaxial: bool = False

    @property
    def finite(self) -> bool:
        """Whether the lens or the lamp is more than a point."""
        return self.focus_distance is not None or self.source_radius > 0.0

    @staticmethod
    def of(scene: Scene) -> PathWorld:
        """Build the world of a scene.

        Raises:
            InputError: a material that returns more light than it gets; a scattering medium without phase function;
                an unreadable mesh; a camera inside a closed object.
        """
        rig, medium = gated_rig(scene), scene.medium
        camera, laser = rig.camera, rig.laser
        electrons = rig.pulses_per_slice * ladar.pixel_photoelectrons(
            pulse_energy_j=laser.pulse_energy_j,
            intensity_per_sr=1.0,
            response_per_sr=1.0,
            lamp_range_m=1.0,
            camera_range_m=1.0,
            attenuation_per_m=0.0,
            pixel_area_m2=camera.pixel_pitch_m**2,
            f_number=camera.f_number,
            transmission=camera.transmission,
            quantum_efficiency=camera.quantum_efficiency,
            wavelength_m=laser.wavelength_m,
        )
        return PathWorld(
            geometry=_geometry(scene),
            lamp=Lamp.of(scene),
            phase=phase_cells_of(scene),
            attenuation=opaque(medium.attenuation_per_m),
            absorption=opaque(medium.absorption_per_m),
            scattering=opaque(medium.scattering_per_m),
            group_index=group_index(medium, laser.wavelength_m),
            electrons=float(electrons),
            rows=camera.rows,
            cols=camera.cols,
            pitch_over_focal=camera.pixel_pitch_m / camera.focal_length_m,
            vignetting=camera.vignetting == "cos4",
            aperture_radius=0.5 * camera.focal_length_m / camera.f_number,
            focus_distance=camera.focus_distance_m,
            source_radius=laser.source_radius_m,
            coaxial=not any(laser.position_m),
        )


def _geometry(scene: Scene) -> Any:
    mi = mitsuba()
    parts: dict[str, Any] = {"type": "scene"}
    for number, item in enumerate(scene.target):
        where = f"{scene.name}: target.{item.name}"
        _check_energy(item.material, where)
        bsdf = mitsuba_bsdf(item.material, shade_of(item, where))
        if isinstance(item.shape, Sphere):
            if np.linalg.norm(item.shape.center_m) <= item.shape.radius_m:
                raise InputError("The camera is inside a target.", where=where, value=item.shape.radius_m)
            center, radius = item.shape.center_m, item.shape.radius_m
            placed: dict[str, Any] = {"center": list(center), "radius": radius}
            if item.texture is not None:
                placed = {"to_world": sphere_frame(center, radius)}
            parts[f"o{number}"] = {"type": "sphere", **placed, "bsdf": bsdf}
            continue
        vertices, faces = shape_mesh(item.shape, where)
        props = mi.Properties()
        props["face_normals"] = True
        props["mesh_bsdf"] = bsdf
        uv = None if item.texture is None else vertex_uv(item, vertices, where)
        mesh = mi.Mesh(f"o{number}", len(vertices), len(faces), has_vertex_texcoords=uv is not None, props=props)
        params = mi.traverse(mesh)
        if uv is not None:
            params["vertex_texcoords"] = np.ascontiguousarray(uv, dtype=np.float32).ravel()
        params["vertex_positions"] = np.ascontiguousarray(vertices, dtype=np.float32).ravel()
        params["faces"] = np.ascontiguousarray(faces, dtype=np.uint32).ravel()
        params.update()
        parts[f"o{number}"] = mesh
    return mi.load_dict(parts, parallel=False, optimize=False)


def _check_energy(material: Material, where: str) -> None:
    """Refuse surfaces that amplify light: what bounces between them has no sum."""
    largest, angle = material.largest_albedo()
    if largest > 1.0 + _ENERGY_SLACK:
        raise InputError(
            "This surface returns more light than it gets, so light that bounces on it has no bound.",
            where=f"{where}.material",
            value=f"hemispherical albedo {largest:.3g} at {np.rad2deg(angle):.0f}° incidence",
            allowed="an albedo of at most 1",
            next_step="lower the material's coefficients, or use fidelity 'direct'",
        )
