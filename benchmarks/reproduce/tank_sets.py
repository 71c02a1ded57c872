"""The five data sets of Kusters 1992, Tables 4.1 and 4.2, and the section of the tank that the laser's plane cuts.

Coordinates in that plane are (down, out) [m] from the laser: down along gravity, out toward the wall. The plane is upright and
holds the tank's axis, so that floor and wall are straight lines and the target is a circle on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...optics.rotation import rotation_matrix
from ...scenes.load import load_scene
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.scene import Scene

__all__ = ["SETS", "DataSet", "Section", "tank_scene"]

Float = NDArray[np.float64]

#: The tank of section 4.1: depth and radius [m].
_DEPTH_M, _RADIUS_M = 3.3, 2.2
#: Length of a target over its diameter, as of the mesh pipe.obj.
_LONG = 5.0


@dataclass(frozen=True)
class DataSet:
    """A row of Tables 4.1 and 4.2. Lengths in m; `view_deg`: angle of the view's middle from the vertical, which is ours: the
    printed ranges need the view rolled toward the corner."""

    number: int
    profiles: int
    target_range_m: float
    corner_range_m: float
    floor_m: float
    wall_m: float
    from_wall_m: float
    diameter_m: float
    view_deg: float

    @property
    def section(self) -> Section:
        """The section by Table 4.2."""
        return Section(self.floor_m, self.wall_m, self.wall_m - self.from_wall_m, 0.5 * self.diameter_m)


@dataclass(frozen=True)
class Section:
    """Floor and wall `floor_m`, `wall_m` from the laser, and a circle of `radius_m` on the floor `target_out_m` out."""

    floor_m: float
    wall_m: float
    target_out_m: float
    radius_m: float

    @property
    def corner_m(self) -> float:
        """Distance of the corner from the laser."""
        return float(np.hypot(self.floor_m, self.wall_m))

    @property
    def centre(self) -> tuple[float, float]:
        """(down, out) of the circle's centre."""
        return self.floor_m - self.radius_m, self.target_out_m

    def distance(self, angle_rad: ArrayLike) -> Float:
        """Distance [m] from the laser to the first surface at an angle from the vertical."""
        return self.surfaces(angle_rad)[0]

    def surfaces(self, angle_rad: ArrayLike) -> tuple[Float, Float]:
        """(distance [m], unit normal (2, …) toward the laser's side as (down, out)) of the first surface at an angle."""
        angle = np.asarray(angle_rad, np.float64)
        way = np.stack([np.cos(angle), np.sin(angle)])
        with np.errstate(divide="ignore", invalid="ignore"):
            floor = np.where(way[0] > 0, self.floor_m / way[0], np.inf)
            wall = np.where(way[1] > 0, self.wall_m / way[1], np.inf)
        centre = np.array(self.centre).reshape(2, *[1] * angle.ndim)
        along = (centre * way).sum(axis=0)
        inside = along**2 - (centre**2).sum(axis=0) + self.radius_m**2
        with np.errstate(invalid="ignore"):
            circle = np.where(inside >= 0, along - np.sqrt(inside), np.inf)
        first = np.minimum(np.minimum(floor, wall), circle)
        normal = np.where(
            first == floor, np.array([-1.0, 0.0]).reshape(centre.shape), np.array([0.0, -1.0]).reshape(centre.shape)
        )
        on_circle = first == circle
        radial = np.where(on_circle, first * way - centre, 0.0) / self.radius_m
        return first, np.where(on_circle, radial, normal)


#: Views rolled by 37 to 50 degrees hold target and corner of each set; a view of 25 degrees in water goes with the lens.
SETS = (
    DataSet(1, 79, 0.97, 1.02, 0.55, 0.85, 0.09, 0.025, 50.0),
    DataSet(2, 73, 1.01, 1.27, 0.91, 0.89, 0.41, 0.2, 37.0),
    DataSet(3, 75, 1.95, 2.42, 1.63, 1.79, 0.83, 0.2, 39.0),
    DataSet(4, 73, 2.59, 3.25, 2.26, 2.34, 1.11, 0.2, 38.0),
    DataSet(5, 72, 3.27, 4.05, 2.77, 2.96, 1.35, 0.2, 39.0),
)


def tank_scene(data_set: DataSet) -> Scene:
    """The scene "spotscan-tank" with tank and target where a data set has them."""
    rig = laser_line_rig(load_scene("spotscan-tank"))
    roll, turn = np.deg2rad(data_set.view_deg), rig.laser.rotation_deg[1]

    def place(down: float, out: float) -> list[float]:
        """A point of the section in the camera's frame: the fan's axis points out and up, its middle ray down and out."""
        along = np.array([0.0, -np.sin(roll) * down + np.cos(roll) * out, np.cos(roll) * down + np.sin(roll) * out])
        held = np.asarray(rig.laser.position_m) + rotation_matrix((0.0, turn, 0.0)) @ along
        return [round(float(x), 6) for x in held]

    section = data_set.section
    return load_scene(
        "spotscan-tank",
        {
            "target.tank.shape.center_m": place(section.floor_m - 0.5 * _DEPTH_M, section.wall_m - _RADIUS_M),
            "target.tank.shape.rotation_deg": [data_set.view_deg - 180.0, turn, 0.0],
            "target.primary.shape.center_m": place(*section.centre),
            "target.primary.shape.size_m": _LONG * data_set.diameter_m,
        },
    )
