"""How what is not the pixel's own direct light changes with range: its derivative by a share by which all ranges grow.

All targets become larger about the camera, x → (1 + ε) x, so that every range r grows to (1 + ε) r: the derivative by a
range is dB/dr = (dB/dε)/r. The image stays as it is, and no edge moves in it.

`scatter`: a rung without randomness, whose convolutions and quadratures are NumPy's and Numba's, where drjit has nothing to
differentiate: central differences of two renderings. `full`: drjit's forward derivative of every traced path (`paths.growth`), and
the central difference of the quadrature of single scattering. What finite lens and lamp change stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ...scenes.grown import grown_scene
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..paths.single import single_electrons
from ..request import Request
from .expected import expect
from .full import Limits, Slices, render_remainder
from .gates import gate_offset, gate_tables, response_width_s
from .stack import slice_coordinates, slice_settings
from .view import view_of

__all__ = ["Growth", "background_growth"]

Float = NDArray[np.float64]

#: Share of the central differences of what is rendered without randomness.
_STEP = 5e-3
#: Largest step of the derivative of paths, as a share of all ranges, and in standard deviations of R: it is linear in both.
_MOST_SHARE, _MOST_SIGMAS = 0.01, 0.2
#: A relative error that no number of paths reaches: all that are allowed are traced.
_ALL = 1e-9


@dataclass(frozen=True)
class Growth:
    """`by_share` (slice, row, col): dB/dε, photoelectrons; `sigma`: its standard error by sampling, 0 where nothing is drawn.
    `samples`: paths per pixel."""

    by_share: Float
    sigma: Float
    samples: int


def background_growth(scene: Scene, rung: str, *, seed: int, key: int, rtol: float, samples: int = 0) -> Growth:
    """dB/dε of the background B of a stack: all its light but the pixel's own direct light.

    Main arguments:
        rung: "scatter" or "full". seed, key, rtol: as `generate` takes them.
        samples: paths per pixel on the rung "full", of which the derivative is taken.

    Raises:
        InputError: another rung; "full" without samples; an impossible scene.
    """
    if rung == "scatter":
        far, near = (_background(grown_scene(scene, by), seed, key, rtol) for by in (_STEP, -_STEP))
        by_share = (far - near) / (2.0 * _STEP)
        return Growth(by_share, np.zeros_like(by_share), 0)
    if rung != "full":
        raise InputError("This rung adds nothing that grows.", where="fidelity", value=rung, allowed="scatter, full")
    if samples < 1:
        raise InputError("A derivative of paths needs paths.", where="samples", value=samples, allowed="1 or more")
    return _traced(scene, seed, key, samples)


def _background(scene: Scene, seed: int, key: int, rtol: float) -> Float:
    """The background of the scatter rung, (slice, row, col)."""
    truth = expect(scene, Request(seed, key, "scatter", rtol)).truth
    return np.asarray(truth["truth_background"], np.float64)


def _traced(scene: Scene, seed: int, key: int, samples: int) -> Growth:
    coords = slice_coordinates(scene)
    delay, scale = slice_settings(scene, coords, seed, key)
    slices = Slices(delay, scale, coords["gate"], gate_offset(scene))
    farthest = float(np.max(delay)) + float(np.ptp(delay))
    step = min(_MOST_SHARE, _MOST_SIGMAS * response_width_s(scene)[0] / max(farthest, 1e-12))
    nothing = np.zeros((len(delay), *_shape(scene)), np.float32)

    def moved(share: float) -> Any:
        return render_remainder(scene, nothing, slices, _ALL, seed, key, limits=Limits(samples), grown=share)

    def single(share: float) -> Float:
        held = grown_scene(scene, share)
        return single_electrons(
            held, view_of(held), gate_tables(held), slices.gate, delay, scale, slices.offset_s
        ).astype(np.float64)

    far, near = moved(step), moved(-step)
    halves = (far.halves.astype(np.float64) - near.halves) / (2.0 * step)
    by_share = halves.mean(axis=0) + (single(_STEP) - single(-_STEP)) / (2.0 * _STEP)
    return Growth(by_share, 0.5 * np.abs(halves[0] - halves[1]), far.samples)


def _shape(scene: Scene) -> tuple[int, int]:
    camera = gated_rig(scene).camera
    return camera.rows, camera.cols
