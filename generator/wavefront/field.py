"""The phase of the light in the pupil: what the water and fixed aberrations add to a flat wavefront, for each reflector.

A mirror at range r returns the beam through the same layers, all z ≤ r, so that their phase counts twice. Light from a spot on a
diffuse target passes them once, as a spherical wave: on its way from z to the array it is spread by r/(r − z).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...optics.zernike import zernike
from ...scenes.rigs.wavefront_geometry import Lattice
from ...scenes.rigs.wavefront_spec import WavefrontRig
from ...scenes.rigs.wavefront_turbulence import Layer, layers_of
from ..random import Stage, generator
from .screens import flowing, screen

__all__ = ["Pupils"]

Float = NDArray[np.float64]

#: A layer this near to the reflector lies before it, m.
_TOUCHING_M = 1e-9
#: Layers that a scene may have: each has a random stream of its own per frame.
_MOST_LAYERS = 16


class Pupils:
    """The phases of all frames, drawn one by one so that a series of any length takes the memory of one frame."""

    def __init__(self, rig: WavefrontRig, lattice: Lattice, seed: int, key: int) -> None:
        self._rig, self._seed, self._key = rig, seed, key
        self._side, self._step = len(lattice.grid_m) + 2, lattice.step_m / rig.bench.magnification
        self._fixed = _aberration(rig, lattice)
        self._layers = layers_of(rig.turbulence)
        # A flow is one large screen per layer; otherwise each frame is a draw of its own.
        self._moving = any(layer.velocity_m_per_s is not None for layer in self._layers)

    @property
    def size(self) -> int:
        """Samples of a side, one around the grid included."""
        return self._side

    def own(self, frame: int) -> Float:
        """Phase [rad] (side + 2, side + 2) that the water does not add: the aberration, and the tilt of the frame's pointing."""
        effects = self._rig.effects
        if effects is None or not effects.pointing_jitter_rad:
            return self._fixed
        tilt = effects.pointing_jitter_rad * generator(self._seed, self._key, Stage.POINTING, frame).standard_normal(2)
        at = self._rig.lenslets.pitch_m / self._rig.pupil.samples * (np.arange(self._side) - 0.5 * (self._side - 1))
        k = 2.0 * np.pi / self._rig.wavelength_m
        return np.asarray(self._fixed + k * (tilt[0] * at[None, :] + tilt[1] * at[:, None]))

    @property
    def step_m(self) -> float:
        """Distance of samples in the water."""
        return self._step

    @property
    def mirror(self) -> bool:
        """Whether the light passes all layers twice."""
        return self._rig.reflection == "mirror"

    @property
    def layers(self) -> tuple[Layer, ...]:
        """The layers, nearest first."""
        return self._layers

    def before(self, range_m: float) -> list[Layer]:
        """The layers between the array and a range."""
        return [layer for layer in self._layers if layer.range_m <= range_m + _TOUCHING_M]

    def phase(self, frame: int, range_m: float) -> Float:
        """Phase [rad] (side + 2, side + 2) of a frame's light from a reflector at `range_m`."""
        total = self.own(frame).copy()
        for _, own in self.screens(frame, range_m, self._side):
            total += (2.0 if self.mirror else 1.0) * own
        return total

    def screens(self, frame: int, range_m: float, side: int) -> Iterator[tuple[Layer, Float]]:
        """The layers before a reflector, nearest first, with the phase [rad] (side, side) that one pass adds to its light."""
        for number, layer in enumerate(self._layers):
            if layer.range_m > range_m + _TOUCHING_M:
                continue
            shrink = 1.0 if self.mirror else max(1.0 - layer.range_m / range_m, 0.0)
            if shrink == 0.0:
                continue  # in the target's plane, where it moves the light as a whole
            yield layer, self._screen(frame, number, layer, self._step * shrink, side)

    def _screen(self, frame: int, number: int, layer: Layer, step_m: float, side: int) -> Float:
        if not self._moving:
            rng = generator(self._seed, self._key, Stage.SCREEN, frame * _MOST_LAYERS + number)
            return screen(side, step_m, layer.r0_m, layer.outer_scale_m, rng)
        rng = generator(self._seed, self._key, Stage.SCREEN, number)
        series = self._rig.frames
        moved = np.outer(series.interval_s * np.arange(series.count), layer.velocity_m_per_s or (0.0, 0.0))
        return flowing(side, step_m, layer.r0_m, layer.outer_scale_m, moved, frame, rng)


def _aberration(rig: WavefrontRig, lattice: Lattice) -> Float:
    side = len(lattice.grid_m) + 2
    if rig.aberration is None or not rig.aberration.noll:
        return np.zeros((side, side))
    edge = lattice.step_m * (np.arange(side) - 0.5 * (side - 1)) / (0.5 * rig.pupil.diameter_m)
    modes = zernike(rig.aberration.noll, edge[None, :], edge[:, None])
    return np.asarray(np.tensordot(np.asarray(rig.aberration.rad), modes, axes=1))
