"""The delay of scattered light in the `scatter` rung: returns split into straight light and groups that come later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.water.delay import SHARES, DelayNodes, delay_nodes, halo_ratio
from ...optics.water.phase_forms import PhaseFunction
from ...scenes.medium_index import group_index
from ...scenes.scene import Scene
from ..rays.lamp import RoundBeam
from ..rays.returns import Returns
from ..rays.trace import pixel_directions
from ..rays.view import View

__all__ = ["Delays", "exact_over_small_angle", "lit_half_angle", "viewed_half_angle"]

Float = NDArray[np.float64]


def lit_half_angle(beam: RoundBeam) -> float:
    """Half angle [rad] of the beam."""
    return min(beam.half_angle_rad, 0.25 * np.pi)


def viewed_half_angle(view: View[RoundBeam]) -> float:
    """Half angle [rad] of what is lit and in view."""
    camera = view.camera
    half = np.arctan(0.5 * max(camera.rows, camera.cols) * camera.pixel_pitch_m / camera.focal_length_m)
    return min(float(half), lit_half_angle(view.lamp))


def exact_over_small_angle(
    scene: Scene, phase: PhaseFunction, half_angle_rad: float, range_m: tuple[float, float]
) -> Callable[[Float], Float]:
    """`halo_ratio` as a function of range, within low … high."""
    grid = np.linspace(range_m[0], max(range_m[1], range_m[0] * 1.001), 3)
    medium = scene.medium
    value = [
        halo_ratio(phase, medium.scattering_per_m, medium.attenuation_per_m, float(r), half_angle_rad) for r in grid
    ]
    return lambda r: np.asarray(np.interp(r, grid, value))


@dataclass(frozen=True, eq=False)
class Delays:
    """`out`: light turned on its way out. `back`: light turned on its way back, and on its way out or not."""

    out: DelayNodes
    back: DelayNodes
    per_metre_s: float

    @staticmethod
    def of(scene: Scene, view: View[RoundBeam], phase: PhaseFunction, range_m: tuple[float, float]) -> Delays:
        """Delays for ranges low … high, as the halo of the view's image needs them."""
        medium, lit = scene.medium, lit_half_angle(view.lamp)
        water = (phase, medium.scattering_per_m, medium.attenuation_per_m, range_m)
        return Delays(
            delay_nodes(*water, lit),
            delay_nodes(*water, viewed_half_angle(view), lit),
            group_index(medium, view.wavelength_m) / C_M_PER_S,
        )

    def turned_share(self, view: View[RoundBeam], outbound: Callable[[Float, Float], Float], range_m: Float) -> Float:
        """X/(I + X) (row, col) of the view's image: the share of the light on the target that was turned on its way out."""
        row, col = (a.ravel() for a in np.mgrid[: view.camera.rows, : view.camera.cols])
        point = pixel_directions(view.camera, row, col) * range_m.ravel()
        ray = point - np.asarray(view.lamp.position_m)[:, None]
        distance = np.sqrt(np.einsum("in,in->n", ray, ray))
        beam = ray / distance
        halo = outbound(beam, distance)
        total = halo + view.lamp.intensity(beam)
        return np.asarray(halo / np.maximum(total, 1e-300)).reshape(range_m.shape)

    def own(self, returns: Returns, turned: Float) -> Returns:
        """Returns of straight light, and of the share `turned` (row, col) in groups that come later."""
        share = np.repeat(turned.ravel(), np.diff(returns.start))
        parts = np.concatenate([(1.0 - share)[:, None], share[:, None] * SHARES], axis=1)
        return self._split(returns, parts, self.out, 1)

    def halo(self, returns: Returns) -> Returns:
        """Returns as the halo of the way back shows them."""
        parts = np.broadcast_to(SHARES, (len(returns.tau), SHARES.size))
        return self._split(returns, parts, self.back, 0)

    def _split(self, returns: Returns, parts: Float, nodes: DelayNodes, straight: int) -> Returns:
        longer, spread = (np.pad(a, ((0, 0), (straight, 0))) for a in nodes.at(0.5 * returns.tau / self.per_metre_s))
        wide = np.hypot(returns.spread[:, None], spread * self.per_metre_s)
        late = returns.tau[:, None] + longer * self.per_metre_s
        return Returns(
            returns.start * parts.shape[1], (returns.amplitude[:, None] * parts).ravel(), late.ravel(), wide.ravel()
        )
