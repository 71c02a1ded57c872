"""Specs of procedural shapes: a box that a recipe fills, and the parameters of each recipe."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from ..base import NonNegative, Positive, Spec, Vec3

__all__ = ["OnGround", "Pipes", "Procedural", "Rocks", "Terraces", "Vegetation", "Wreck"]

#: Smallest and largest of what is drawn uniformly between them [m].
Between = tuple[Positive, Positive]

#: The ground lies within this many `ground_rms_m` of its mean.
GROUND_SPAN = 3.0
#: A solid that lies on the ground is buried by this share of its height.
BURIED = 0.15


class Procedural(Spec):
    """A box that a recipe fills with triangles: `size_m` along x, y, z, turned about its centre by Euler angles (x, then y,
    then z). Unturned, its ground is seen from above: it spans x and y at the far end of the box, and all else rises from it
    toward the camera. Nothing reaches beyond the box, and no camera may stand within it.

    `seed` and the recipe's parameters decide the geometry: equal ones give equal triangles, up to the rounding of the processor.
    `part`: "all", or the "ground" or the "objects" of the same draw alone, so that each can be a target of its own material.
    """

    #: Raised when the same parameters give other triangles: the split of a data set counts it.
    recipe_version: ClassVar[int] = 1

    center_m: Vec3
    size_m: tuple[Positive, Positive, Positive]
    rotation_deg: Vec3
    seed: Annotated[int, Field(ge=0, le=2**53 - 1)]
    part: Literal["all", "ground", "objects"]

    def room_m(self) -> float:
        """Side of the largest cube that fits upon the ground."""
        return min(self.size_m)

    def _between(self, **ranges: tuple[float, float]) -> None:
        """Refuse ranges that are out of order, or whose largest does not fit upon the ground."""
        for name, (low, high) in ranges.items():
            if low > high:
                raise ValueError(f"{name} is [smallest, largest], not [{low:g}, {high:g}]")
            if high > self.room_m() * (1.0 + 1e-9):
                raise ValueError(f"{name} of {high:g} m does not fit: there are {self.room_m():g} m upon the ground")


class OnGround(Procedural):
    """With an uneven ground: Gaussian heights of `ground_rms_m`, cut off at three times that, of waves of about
    `ground_scale_m`."""

    ground_rms_m: NonNegative
    ground_scale_m: Positive

    def room_m(self) -> float:
        """Side of the largest cube that fits upon the highest ground."""
        return min(*self.size_m[:2], self.size_m[2] - 2.0 * GROUND_SPAN * self.ground_rms_m)

    @model_validator(mode="after")
    def _ground_fits(self) -> OnGround:
        if self.room_m() <= 0:
            raise ValueError(f"the ground's heights take {2 * GROUND_SPAN * self.ground_rms_m:g} m of the box's depth")
        return self


class Rocks(OnGround):
    """Rocks strewn on a ground: closed bodies of `diameter_m` [smallest, largest], `roughness` the relative depth of their
    lumps, with flat faces broken off."""

    kind: Literal["rocks"] = "rocks"
    rocks: Annotated[int, Field(ge=1, le=40)]
    diameter_m: Between
    roughness: Annotated[float, Field(ge=0, le=0.5)]

    @model_validator(mode="after")
    def _fits(self) -> Rocks:
        self._between(diameter_m=self.diameter_m)
        return self


class Pipes(OnGround):
    """Pipes across a ground, along x, each in a strip of its own: `bends` S-bends of a radius of at least `bend_radius_m`,
    flanges every `flange_spacing_m`, and a riser with a cap."""

    kind: Literal["pipes"] = "pipes"
    pipes: Annotated[int, Field(ge=1, le=4)]
    diameter_m: Between
    bends: Annotated[int, Field(ge=0, le=4)]
    bend_radius_m: Positive
    flange_spacing_m: Positive

    @model_validator(mode="after")
    def _fits(self) -> Pipes:
        self._between(diameter_m=self.diameter_m)
        wide = 1.6 * self.diameter_m[1]
        if wide * self.pipes > self.size_m[1]:
            raise ValueError(
                f"{self.pipes} pipes with flanges of {wide:g} m do not fit side by side into the box's height"
            )
        if wide > self.room_m():
            raise ValueError(f"flanges of {wide:g} m do not fit upon the ground")
        if self.bend_radius_m < self.diameter_m[1]:
            raise ValueError("bend_radius_m should be at least the largest diameter: a tighter pipe would cut itself")
        if self.flange_spacing_m < self.diameter_m[1]:
            raise ValueError("flange_spacing_m should be at least the largest diameter")
        return self


class Terraces(Procedural):
    """Steps with upright risers of `rise_m` [smallest, largest], up or down, along one side of the box, and blocks of
    `block_m` that lie on their treads. The steps are the ground."""

    kind: Literal["terraces"] = "terraces"
    steps: Annotated[int, Field(ge=2, le=24)]
    rise_m: Between
    blocks: Annotated[int, Field(ge=0, le=200)]
    block_m: Between

    def room_m(self) -> float:
        """Side of the largest cube that fits upon the highest step: steps take half of the box's depth."""
        return min(*self.size_m[:2], 0.5 * self.size_m[2])

    @model_validator(mode="after")
    def _fits(self) -> Terraces:
        self._between(rise_m=self.rise_m, block_m=self.block_m)
        if self.part == "objects" and not self.blocks:
            raise ValueError('part "objects" of terraces without blocks holds nothing')
        return self


class Vegetation(OnGround):
    """Plants that stand on a ground, half of them tufts of thin blades, half branched, `height_m` [smallest, largest] high;
    all lean with the current, by `lean_deg` at their tips."""

    kind: Literal["vegetation"] = "vegetation"
    plants: Annotated[int, Field(ge=1, le=40)]
    height_m: Between
    blade_width_m: Positive
    lean_deg: Annotated[float, Field(ge=0, le=80)]

    @model_validator(mode="after")
    def _fits(self) -> Vegetation:
        self._between(height_m=self.height_m)
        if self.blade_width_m > 0.2 * self.height_m[0]:
            raise ValueError("blade_width_m should be at most a fifth of the smallest height")
        return self


class Wreck(OnGround):
    """Wreckage on a ground: boxes, plates, cylinders, and frames of beams, each turned at random, `piece_m` [smallest, largest]
    the diameter of the ball around one."""

    kind: Literal["wreck"] = "wreck"
    pieces: Annotated[int, Field(ge=1, le=60)]
    piece_m: Between

    @model_validator(mode="after")
    def _fits(self) -> Wreck:
        self._between(piece_m=self.piece_m)
        return self
