"""A random family of scenes that no rung was designed for: media, shapes, near and far, random albedos, tilts and beams.

Scenes far from any border between rungs do not test the choice. The draw is therefore stratified: the light that one rung
neglects in a scene is aimed at one of the limits, times a log-uniform factor in 1/3 … 3, through the albedo (light between
surfaces) or the scattering coefficient of the water (light scattered forward). The aim is rough, by one number for each
shape; the result is measured. Some waters have natural coefficients.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.load import load_scene
from ...scenes.scene import Scene

__all__ = ["LIMITS", "MEDIA", "SHAPES", "STRATA", "draw_scene", "family"]

#: a and b [1/m] at 514 nm (Petzold 1972; air has none), and the near and far range [m].
MEDIA: dict[str, tuple[float, float, float, float]] = {
    "air": (0.0, 0.0, 3.0, 15.0),
    "faint": (0.046, 0.0, 2.0, 8.0),
    "clear": (0.114, 0.037, 2.0, 8.0),
    "coastal": (0.179, 0.219, 1.5, 4.0),
    "harbour": (0.366, 1.824, 0.8, 1.5),
}
SHAPES = ("flat", "corner", "bowl", "relief", "mesh")
LIMITS = (0.1, 0.03, 0.01)
#: Strata, in turn: medium, shapes, and the quantity aimed at a limit: "albedo", "scattering", or none.
STRATA: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("air", ("corner", "bowl", "relief", "mesh"), "albedo"),
    ("faint", ("flat", "mesh"), "scattering"),
    ("coastal", ("corner", "bowl", "relief"), "albedo"),
    ("harbour", ("flat", "corner", "relief", "mesh"), ""),
    ("clear", ("corner", "bowl", "relief"), "albedo"),
    ("faint", ("flat", "corner", "bowl", "relief", "mesh"), "scattering"),
    ("air", ("corner", "bowl", "relief", "flat"), "albedo"),
    ("coastal", ("flat", "mesh"), ""),
    ("harbour", ("corner", "bowl", "relief"), "albedo"),
    ("clear", ("flat", "corner", "mesh"), ""),
)

#: Light between surfaces relative to all light, per albedo: rms over the stack, a typical value for each shape.
_SECOND_BOUNCE = {"flat": 0.1, "corner": 0.19, "bowl": 0.1, "relief": 0.25, "mesh": 0.01}
#: Tangent of the half field of view of the camera.
_FIELD = 0.3
_SIZE = 10
_SLICES = 16
_GROUP_INDEX = 1.36


def family(seed: int, count: int, folder: Path) -> list[Scene]:
    """`count` scenes: the strata in turn, shapes and distances drawn without repetition, the rest independently. Meshes are
    written to `folder`."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    kinds: list[list[tuple[str, bool]]] = []
    for _, shapes, _ in STRATA:
        every = [(shape, far) for far in (False, True) for shape in shapes]
        kinds.append([every[i] for i in rng.permutation(len(every))])
    scenes = []
    for number in range(count):
        stratum, turn = number % len(STRATA), number // len(STRATA)
        medium, _, aim = STRATA[stratum]
        shape, far = kinds[stratum][turn % len(kinds[stratum])]
        scenes.append(draw_scene(seed, number, medium, shape, far, folder, aim))
    return scenes


def draw_scene(seed: int, number: int, medium: str, shape: str, far: bool, folder: Path, aim: str = "") -> Scene:
    """One scene; the draw depends only on `seed` and `number`. `aim`: the quantity set so that the error of a rung is about a
    limit: "albedo", "scattering", or "" for neither."""
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    absorption, scattering, near_m, far_m = MEDIA[medium]
    distance = (far_m if far else near_m) * draw.uniform(0.85, 1.15)
    albedo = float(np.exp(draw.uniform(np.log(0.02), np.log(0.9))))
    error = LIMITS[draw.integers(len(LIMITS))] * float(np.exp(draw.uniform(-np.log(3.0), np.log(3.0))))
    turbid = float(np.exp(draw.uniform(np.log(0.4), np.log(1.2))))
    if aim == "albedo":
        albedo = float(np.clip(error / _SECOND_BOUNCE[shape], 0.01, 0.95))
    if aim == "scattering":
        scattering = float(np.log1p(error)) / (2.0 * distance)
        albedo = min(albedo, 0.1)
    elif medium in ("coastal", "harbour"):
        absorption, scattering = absorption * turbid, scattering * turbid
    group = 1.00028 if medium == "air" else _GROUP_INDEX
    target, depth = _target(shape, distance, albedo, draw, folder, number)
    # The gate of the camera is closed while the pulse passes the water in front of its own lens.
    first, last = max(2 * (distance - depth - 0.3), distance), 2 * (distance + 0.6 * depth + 0.4)
    per_metre = group / 299_792_458.0
    index = {"kind": "explicit", "phase": min(group, 1.34), "group": group}
    water: dict[str, Any] = {
        "name": medium, "index": index, "absorption_per_m": absorption, "scattering_per_m": scattering,
    }  # fmt: skip
    if scattering:
        water["phase_function"] = {"kind": "fournier-forand", "index": 1.1, "slope": 3.58}
    return load_scene(
        "flat-wall",
        {
            "name": f"{medium}-{shape}-{'far' if far else 'near'}-{number}",
            "target": target,
            "medium": water,
            "rig.camera.rows": _SIZE,
            "rig.camera.cols": _SIZE,
            "rig.camera.focal_length_m": 13.0e-6 * _SIZE / 2 / _FIELD,
            "rig.laser.illumination.half_angle_rad": float(draw.uniform(0.15, 0.45)),
            "rig.delays.start_s": float(first * per_metre),
            "rig.delays.step_s": float((last - first) * per_metre / _SLICES),
            "rig.delays.count": _SLICES,
        },
    )


def _target(
    shape: str, distance: float, albedo: float, draw: np.random.Generator, folder: Path, number: int
) -> tuple[list[dict[str, Any]], float]:
    """Objects at a distance [m], and their extent toward the camera [m]."""
    lambert = {"kind": "lambert", "albedo": albedo}
    wide = 2.6 * _FIELD * distance

    def item(name: str, **form: Any) -> dict[str, Any]:
        return {"name": name, "shape": form, "material": lambert}

    def wall(name: str, x: float, z: float, width: float, tilt: float) -> dict[str, Any]:
        place = {"center_m": [x, 0.0, z], "width_m": width, "height_m": wide, "tilt_x_deg": 0.0, "tilt_y_deg": tilt}
        return item(name, kind="rectangle", **place)

    if shape == "flat":
        tilt = float(draw.uniform(-30, 30))
        return [wall("wall", 0.0, distance, 1.3 * wide, tilt)], 0.4 * wide
    if shape == "corner":
        opening = np.deg2rad(draw.uniform(35, 60))  # of each wall from the axis
        width = float(draw.uniform(0.3, 0.5)) * wide
        x, z = 0.5 * width * np.sin(opening), distance - 0.5 * width * np.cos(opening)
        tilt = 90.0 - float(np.rad2deg(opening))
        return [
            wall("left", -float(x), float(z), width, -tilt),
            wall("right", float(x), float(z), width, tilt),
        ], float(width * np.cos(opening))  # fmt: skip
    if shape == "mesh":
        import trimesh

        file = folder / f"torus-{number}.ply"
        trimesh.creation.torus(0.35, 0.15, major_sections=24, minor_sections=12).export(file)
        size = 0.6 * wide
        turn = [float(v) for v in draw.uniform(0, 180, 3)]
        place = [0.0, 0.0, distance - 0.55 * size]
        ring = item("ring", kind="mesh", file=str(file), size_m=size, center_m=place, rotation_deg=turn)
        return [ring, wall("wall", 0.0, distance, 1.3 * wide, 0.0)], 1.1 * size
    relief = float(draw.uniform(0.1, 0.5)) * wide
    file_name = "library:relief.npz"
    if shape == "bowl":
        axis = np.linspace(-1.0, 1.0, 41)
        path = folder / f"bowl-{number}.npy"
        np.save(path, np.minimum(axis[:, None] ** 2 + axis**2, 1.0))
        file_name = str(path)
    grid = {"center_m": [0.0, 0.0, distance], "width_m": wide, "relief_m": relief, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0}
    return [item(shape, kind="height-grid", file=file_name, **grid)], relief
