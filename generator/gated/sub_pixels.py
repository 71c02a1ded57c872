"""Echoes of the pixels that need more than one ray, traced and merged block by block: memory is that of a block of rays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...scenes.scene import Scene
from ..rays.echo import Halo, echoes
from ..rays.lamp import Lamp
from ..rays.returns import Returns, gather_returns
from ..rays.subsampling import SubsamplePlan, lattice
from ..rays.trace import Tracer, pixel_directions
from ..rays.view import View

__all__ = ["MOST_RAYS", "sub_pixel_returns"]

Float = NDArray[np.float64]

#: Rays that are held at a time: some 200 bytes each.
MOST_RAYS = 1 << 19


def sub_pixel_returns(
    scene: Scene, view: View[Lamp], tracer: Tracer, halo: Halo | None, groups: Sequence[SubsamplePlan],
    alone: tuple[Float, Float, Float], width_s: float,
) -> tuple[Returns, Float, Float, int]:  # fmt: skip
    """Returns of all pixels, the first and last time of each that carries light (NaN where there is none), and the rays of groups.

    Main arguments:
        groups: pixels with several rays. alone: (amplitude, time, spread) over all pixels, of those that one ray stands for.
        width_s: as of `gather_returns`.
    """
    pixels = alone[0].size
    single = np.ones(pixels, dtype=np.bool_)
    for group in groups:
        single[group.pixel] = False
    nothing = np.zeros(0)
    whole, first, last = gather_returns(
        pixels, np.zeros(0, np.int64), nothing, nothing, nothing, width_s, (single, *alone)
    )
    if not groups:
        return whole, first, last, 0
    owner = [np.repeat(np.arange(pixels), np.diff(whole.start))]
    parts = [(whole.amplitude, whole.tau, whole.spread)]
    rays = 0
    for pixel, n in _blocks(groups):
        row, col = (
            (at[:, None] + d).ravel() for at, d in zip(np.divmod(pixel, view.camera.cols), lattice(n * n), strict=True)
        )
        direction = pixel_directions(view.camera, row, col)
        echo = echoes(scene, view, tracer, direction, tracer.trace((0.0, 0.0, 0.0), direction), halo)
        spread = np.sqrt((echo.tau_per_row**2 + echo.tau_per_col**2) / 12.0) / n
        local = np.repeat(np.arange(pixel.size), n * n)
        made, first[pixel], last[pixel] = gather_returns(
            pixel.size, local, echo.amplitude / (n * n), echo.tau, spread, width_s
        )
        owner.append(np.repeat(pixel, np.diff(made.start)))
        parts.append((made.amplitude, made.tau, made.spread))
        rays += row.size
    owners = np.concatenate(owner)
    order = np.argsort(owners, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(owners, minlength=pixels))]).astype(np.int64)
    amplitude, tau, width = (np.concatenate(column)[order] for column in zip(*parts, strict=True))
    return Returns(start, amplitude, tau, width), first, last, rays


def _blocks(groups: Sequence[SubsamplePlan]) -> Iterator[tuple[NDArray[np.int64], int]]:
    """(pixels, n) with no more than `MOST_RAYS` rays each."""
    for group in groups:
        step = max(MOST_RAYS // (group.n * group.n), 1)
        for begin in range(0, group.pixel.size, step):
            yield group.pixel[begin : begin + step], group.n
