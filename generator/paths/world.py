"""A scene as the path tracer sees it: Mitsuba's geometry with our BSDFs, the lamp, the medium, the camera's factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from ...scenes.materials import Material
from ...scenes.medium_index import group_index
from ...scenes.meshes import shape_mesh
from ...scenes.scene import Scene
from ...scenes.shapes import Sphere
from ..bsdf.plugin import mitsuba_bsdf
from ..bsdf.texture import shade_of, sphere_frame, vertex_uv
from ..rays.backend import mitsuba, opaque, ray_scene
from ..rays.lamp import DeviceLamp, Lamp
from ..rays.view import View
from .phase import PhaseCells, phase_cells_of

__all__ = ["PathWorld", "path_geometry"]

#: A law may return this share more than it gets, at grazing angles, before it is refused.
_ENERGY_SLACK = 1e-3


@dataclass(frozen=True)
class PathWorld:
    """All that the loop needs. `electrons`: photoelectrons of a slice per unit of radiance that a unit of emitted energy
    gives on the axis; `attenuation`, `absorption`, `scattering` 1/m; `phase` None where nothing scatters; `focus_distance` m
    None where all is sharp; `coaxial`: whether lamp and camera are at one point."""

    geometry: Any
    lamp: DeviceLamp
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
    def of(scene: Scene, view: View[Lamp]) -> PathWorld:
        """Build the world of a scene and a view.

        Raises:
            InputError: a material that returns more light than it gets; a scattering medium without phase function;
                an unreadable mesh; a camera inside a closed object.
        """
        medium, camera = scene.medium, view.camera
        return PathWorld(
            geometry=path_geometry(scene),
            lamp=view.lamp.on_device(),
            phase=phase_cells_of(scene),
            attenuation=opaque(medium.attenuation_per_m),
            absorption=opaque(medium.absorption_per_m),
            scattering=opaque(medium.scattering_per_m),
            group_index=group_index(medium, view.wavelength_m),
            electrons=float(view.electrons()),
            rows=camera.rows,
            cols=camera.cols,
            pitch_over_focal=camera.pixel_pitch_m / camera.focal_length_m,
            vignetting=camera.vignetting == "cos4",
            aperture_radius=0.5 * camera.focal_length_m / camera.f_number,
            focus_distance=camera.focus_distance_m,
            source_radius=view.lamp.source_radius_m,
            coaxial=view.coaxial,
        )


def path_geometry(scene: Scene) -> Any:
    """Mitsuba's scene of the targets with their reflection laws. Raises InputError as `PathWorld.of` does for targets."""
    mi = mitsuba()
    parts: dict[str, Any] = {}
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
    return ray_scene(parts)


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
