"""The `scatter` rung: direct light, the halo of forward scattering on both ways, and the medium's backscatter.

What is modelled. The way out: the beam's profile convolved with the small-angle point spread of the medium, per ray.
The way back: the unscattered share e^{−cr} stays in its pixel, the rest is a halo over the image, slice by slice, with
kernels that follow range. The backscatter ramp: one turn by a large angle, by quadrature along every pixel's ray up to
the target, with forward scattering on both ways and the mean turn of light that arrives askew. All times run at the group velocity.

Delays. Light turned on its way is longer on it (`optics.water.delay`): the return is split into straight light and groups
that come later, by the share X/(I + X) turned on the way out; halo light comes in groups too. The halo's strength is that
of the exact triangle and of a matt target's slant, a few percent below the small-angle picture's.

How good that is, against traced paths on walls (tests/test_generator_effect_sizes.py, `beambench fidelity`): ε .1-.5 % in clear
water (Petzold, 2-8 m), .3-1.7 % in coastal (1.5-4 m) and .4-2 % in harbour water (.8 m), where without delays it was .4-3, 1.4-6
and 4 %. On dark targets in harbour water, and on corners, it is 2-6 %.

What is left out: delays of the ramp's own light, halo from objects outside the widened image, paths with two or more turns by
large angles, light between surfaces, and shadows in the halo.

Truth. `truth_amplitude` is the light that was reflected once and not scattered, on this rung as on the others; what came from
the pixel's own surface scattered forward, what comes from other pixels, and the ramp are `truth_background` (slice, row, col).
`truth_halo` (row, col) is the target's part of that at an open gate: it moves with the target as a whole, and so carries range
for estimators that use it (docs/decisions/0017). `render_scatter` itself counts as `truth_amplitude` all light of the pixel's own
surface that arrives in the pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.water.beam import BeamHalo, tabulate_beam_halo
from ...optics.water.phase_forms import PhaseFunction
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..rays.lamp import RoundBeam
from ..rays.returns import Returns, render_stack
from ..rays.trace import Tracer, pixel_directions
from ..rays.view import View
from ..water.delays import Delays, exact_over_small_angle, lit_half_angle, viewed_half_angle
from ..water.image import ImageHalo, image_halo
from ..water.phase import phase_of
from ..water.ramp import backscatter_electrons
from .direct import DirectScene, render_direct
from .gates import gate_offset_image, gate_tables
from .view import view_of

__all__ = ["ScatterScene", "forward_electrons", "halo_electrons", "render_scatter", "scattered_electrons"]

Float = NDArray[np.float64]

#: Slices of the widened image in memory at once.
_BATCH = 8
#: Width by which the image is widened on each side, as a share of it: halo from further away is left out.
_MARGIN = 0.5


@dataclass(frozen=True, eq=False)
class ScatterScene:
    """`direct`: the return of each pixel's own surface, with its truth. `wide`: unscattered returns of the widened image
    that the halo comes from; None where nothing scatters. `halo`: kernels of the way back; `weight` (kernel, row, col)
    and `field` (row, col): shares among the kernels, and the lens's falloff that the halo must not inherit."""

    direct: DirectScene
    phase: PhaseFunction | None = None
    wide: Returns | None = None
    halo: ImageHalo | None = None
    weight: NDArray[np.float32] | None = None
    field: NDArray[np.float32] | None = None


class _Outbound:
    """I ⊗ h of the way out, as `echoes` takes it; tabulated over the ranges of its first, full set of rays."""

    def __init__(self, scene: Scene, view: View[RoundBeam], phase: PhaseFunction) -> None:
        self._scene, self._lamp, self._phase = scene, view.lamp, phase
        self._table: BeamHalo | None = None

    def __call__(self, beam: Float, range_m: Float) -> Float:
        """X [1/sr] along unit directions (3, n) at ranges (n)."""
        if self._table is None:
            between = (float(range_m.min()), float(range_m.max()))
            self._table = tabulate_beam_halo(
                self._lamp.profile, self._lamp.edge_rad, self._phase, self._scene.medium.scattering_per_m, between, 1
            )
            self._ratio = exact_over_small_angle(self._scene, self._phase, lit_half_angle(self._lamp), between)
        return self._table.at(self._lamp.angle(beam), range_m) * self._ratio(range_m)


def render_scatter(scene: Scene, rtol: float, tracer: Tracer | None = None) -> ScatterScene:
    """Trace the scene with light scattered forward.

    Main arguments:
        scene, rtol, tracer: as for `render_direct`.

    Without scattering the result is that of `render_direct`, to the bit.

    Raises:
        InputError: the medium scatters but has no phase function.
    """
    phase = phase_of(scene)
    tracer = tracer or Tracer(scene)
    if phase is None:
        return ScatterScene(render_direct(scene, rtol, tracer))
    rig = gated_rig(scene)
    rows, cols = rig.camera.rows, rig.camera.cols
    margin = int(_MARGIN * max(rows, cols))
    camera = rig.camera.model_copy(update={"rows": rows + 2 * margin, "cols": cols + 2 * margin})
    widened = scene.model_copy(update={"rig": rig.model_copy(update={"camera": camera})})
    view = view_of(widened)
    outbound = _Outbound(scene, view, phase)
    wide = render_direct(widened, rtol, tracer, outbound)
    distance = np.asarray(wide.truth["truth_range"])
    seen = np.isfinite(distance)
    inner = (slice(margin, margin + rows), slice(margin, margin + cols))
    truth = {name: value[inner] for name, value in wide.truth.items()}
    if not seen.any():
        return ScatterScene(
            DirectScene(_cropped(wide.returns, seen, inner, np.ones((rows, cols))), truth, wide.rays), phase
        )
    filled = np.where(seen, distance, float(np.median(distance[seen])))
    between = (float(filled.min()), float(filled.max()))
    halo = image_halo(rig.camera, margin, phase, scene.medium.scattering_per_m, between)
    gain = 1.0 + halo.own_share(filled[inner])
    truth["truth_amplitude"] = truth["truth_amplitude"] * gain
    late = Delays.of(scene, view, phase, between)
    turned = late.turned_share(view, outbound, filled)
    returns = late.own(_cropped(wide.returns, seen, inner, gain), turned[inner])
    falloff = np.ones(filled.shape)
    if camera.vignetting == "cos4":
        row, col = (a.ravel() for a in np.mgrid[: camera.rows, : camera.cols])
        falloff = (pixel_directions(camera, row, col)[2] ** 4).reshape(filled.shape)
    ratio = exact_over_small_angle(scene, phase, viewed_half_angle(view), between)
    weight = np.asarray(halo.weights(filled) * ratio(filled) / falloff, dtype=np.float32)
    return ScatterScene(
        DirectScene(returns, truth, wide.rays),
        phase,
        late.halo(wide.returns),
        halo,
        weight,
        falloff[inner].astype(np.float32),
    )


def _cropped(wide: Returns, image: NDArray[Any], inner: tuple[slice, slice], gain: Float) -> Returns:
    """The returns of the inner pixels, their light times `gain` (row, col)."""
    number = np.arange(image.size).reshape(image.shape)[inner].ravel()
    count = wide.start[number + 1] - wide.start[number]
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    take = np.repeat(wide.start[number] - start[:-1], count) + np.arange(start[-1])
    return Returns(start, wide.amplitude[take] * np.repeat(gain.ravel(), count), wide.tau[take], wide.spread[take])


def scattered_electrons(
    scene: Scene, scatter: ScatterScene, gate: NDArray[np.int32], delay_s: Float, scale: Float
) -> NDArray[np.float32]:
    """Photoelectrons (slice, row, col) that carry other ranges than the pixel's own: halo of other pixels, and ramp.

    Main arguments:
        scatter: of `render_scatter`.
        gate, delay_s, scale: gate, true optical delay and relative energy of each slice (zero: laser off).
    """
    rig = gated_rig(scene)
    rows, cols = rig.camera.rows, rig.camera.cols
    if scatter.phase is None:
        return np.zeros((len(delay_s), rows, cols), dtype=np.float32)
    tables = gate_tables(scene)
    offset = gate_offset_image(scene)
    total = backscatter_electrons(
        scene, view_of(scene), scatter.phase, tables, gate, delay_s, scale,
        np.asarray(scatter.direct.truth["truth_range"]), offset,
    )  # fmt: skip
    halo, wide = scatter.halo, scatter.wide
    if halo is None or wide is None or scatter.weight is None or scatter.field is None:
        return total
    shape = (rows + 2 * halo.margin, cols + 2 * halo.margin)
    # The gate opens at the pixel where the halo lands; it is taken to open as at the pixel that it comes from.
    wide_offset = None if offset is None else np.pad(offset, halo.margin, mode="edge")
    for number, table in enumerate(tables):
        own = np.flatnonzero((gate == number) & (scale > 0))
        for begin in range(0, len(own), _BATCH):
            part = own[begin : begin + _BATCH]
            stack = np.empty((len(part), shape[0] * shape[1]), dtype=np.float32)
            render_stack(wide, table, delay_s[part], scale[part], wide_offset, stack)
            for k, image in zip(part, stack.reshape(-1, *shape), strict=True):
                total[k] += halo.spread(image, scatter.weight) * scatter.field
    return total


def halo_electrons(scatter: ScatterScene) -> Float:
    """Photoelectrons (row, col) at an open gate of the halo that other pixels' light brings to each pixel."""
    amplitude = np.asarray(scatter.direct.truth["truth_amplitude"], np.float64)
    halo, wide = scatter.halo, scatter.wide
    if halo is None or wide is None or scatter.weight is None or scatter.field is None:
        return np.zeros(amplitude.shape)
    running = np.concatenate([[0.0], np.cumsum(wide.amplitude)])
    image = (running[wide.start[1:]] - running[wide.start[:-1]]).astype(np.float32)
    rows, cols = amplitude.shape
    image = image.reshape(rows + 2 * halo.margin, cols + 2 * halo.margin)
    return np.asarray(halo.spread(image, scatter.weight) * scatter.field, np.float64)


def forward_electrons(scene: Scene, own: Float, rtol: float, tracer: Tracer | None = None) -> Float:
    """Photoelectrons (row, col) at an open gate of target light that was scattered forward, beside the unscattered `own`.

    The small-angle picture's, for the truth of rungs that trace such light without telling it from the rest.
    """
    scatter = render_scatter(scene, rtol, tracer)
    total = np.asarray(scatter.direct.truth["truth_amplitude"], np.float64) + halo_electrons(scatter)
    return np.maximum(total - own, 0.0)
