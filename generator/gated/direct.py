"""The `direct` rung: one bounce, deterministic sub-pixel rays, exact times.

Returns the echoes of every pixel (`Returns`) and the truth; the stack follows by `render_stack`.

Neighbouring centre rays tell where one ray is not enough. What recurs in every pixel (slats, a net, fine texture) they do not
see; so some pixels that look smooth are asked with several rays too, and where those disagree all pixels get more. The limit of
that: structure smaller than a pixel that few pixels hold, and that no centre ray near it meets, is missed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.correlation import waveforms
from ...optics.correlation.response import Table, correlation_support, lookup
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.sampling import optics_gate, optics_pulse, response_table
from ...scenes.scene import Scene
from ..rays.echo import Echoes, echoes
from ..rays.returns import Returns, gather_returns
from ..rays.subsampling import centre_error, lattice, plan, stack_power
from ..rays.trace import Hits, Tracer, pixel_directions
from .slice_view import slice_view

__all__ = ["MIXED_FRACTION", "DirectScene", "gate_tables", "render_direct", "response_width_s"]

Float = NDArray[np.float64]
Rays = TypeVar("Rays", Hits, Echoes)

#: Samples within this many σ of R become one return.
_MERGE_SIGMAS = 0.25
#: The contract: a pixel is mixed where its sub-samples span over this fraction of R's full width at half maximum.
MIXED_FRACTION = 0.05
#: One pixel in so many is asked with several rays; rays for each, and by how much these may disagree with its centre.
_PIXELS_PER_PROBE = 32
_PROBE_RAYS = 9
_PROBE_SLACK = 4.0
#: Accuracy of the tabulated R, relative to its peak.
_TABLE_RTOL = 1e-5


@dataclass(frozen=True)
class DirectScene:
    """The direct light of a scene: `returns` over flat pixels, and `truth` arrays by name."""

    returns: Returns
    truth: dict[str, Any]
    rays: int


def gate_tables(scene: Scene) -> list[Table]:
    """R(u) of every gate, with the pulse broadened by the jitter of single shots."""
    laser = gated_rig(scene).laser
    pulse = waveforms.broadened(optics_pulse(laser.pulse), laser.jitter_shot_s)
    gates = enumerate(gated_rig(scene).gates)
    return [response_table(pulse, optics_gate(g), _TABLE_RTOL, f"{scene.name}: rig.gates.{i}") for i, g in gates]


def response_width_s(scene: Scene) -> tuple[float, float]:
    """(σ, full width at half maximum) of R(u) of the first gate [s]."""
    pulse = waveforms.broadened(optics_pulse(gated_rig(scene).laser.pulse), gated_rig(scene).laser.jitter_shot_s)
    gate = optics_gate(gated_rig(scene).gates[0])
    u = np.linspace(*correlation_support(pulse, gate), 4001)
    r = lookup(response_table(pulse, gate, 1e-4, f"{scene.name}: rig.gates.0"), u)
    mean = float((u * r).sum() / r.sum())
    sigma = float(np.sqrt(((u - mean) ** 2 * r).sum() / r.sum()))
    above = u[r >= r.max() / 2]
    return sigma, float(above[-1] - above[0])


def render_direct(
    scene: Scene,
    rtol: float,
    tracer: Tracer | None = None,
    halo: Callable[[Float, Float], Float] | None = None,
    *,
    with_truth: bool = True,
) -> DirectScene:
    """Trace the scene and gather its echoes.

    Main arguments:
        scene: what is there.
        rtol: relative error ε of the stack aimed at by the sub-pixel sampling.
    Other arguments:
        tracer: reuse an earlier one (same target).
        halo: intensity added to the beam's own, as in `echoes`.
        with_truth: also gather the truth; without it `truth` is empty.
    """
    tracer = tracer or Tracer(scene)
    camera = gated_rig(scene).camera
    rows, cols = camera.rows, camera.cols
    sigma, fwhm = response_width_s(scene)
    # One ring of rays around the image tells of edges in its outermost pixels.
    ring = (rows + 2, cols + 2)
    wide_row, wide_col = (a.ravel() - 1 for a in np.mgrid[: ring[0], : ring[1]])
    row, col = (a.ravel() for a in np.mgrid[:rows, :cols])
    probed = _probed(rows * cols)
    d_row, d_col = lattice(_PROBE_RAYS)
    near_row, near_col = ((at[probed, None] + d).ravel() for at, d in ((row, d_row), (col, d_col)))
    direction = pixel_directions(camera, np.concatenate([wide_row, near_row]), np.concatenate([wide_col, near_col]))
    hits = tracer.trace((0.0, 0.0, 0.0), direction)
    echo = echoes(scene, tracer, direction, hits, halo)
    count = wide_row.size
    probes = _cut(echo, slice(count, None))
    direction, hits, echo = direction[:, :count], _cut(hits, slice(count)), _cut(echo, slice(count))
    amplitude, tau, per_row, per_col = (
        a.reshape(ring) for a in (echo.amplitude, echo.tau, echo.tau_per_row, echo.tau_per_col)
    )
    shown, weight = slice_view(scene, gate_tables(scene), sigma, tau)
    error, bright, shift, spread = centre_error(amplitude, tau, per_row, per_col, sigma, weight)
    inside = (row[probed] + 1, col[probed] + 1)
    plane = tau[inside][:, None] + per_row[inside][:, None] * d_row + per_col[inside][:, None] * d_col
    late = np.abs(probes.tau.reshape(plane.shape) - plane) / sigma
    light_near = probes.amplitude.reshape(plane.shape)
    recurs = _recurring_error(
        error.ravel()[probed], bright.ravel()[probed] > 0.0, amplitude[inside], light_near, late, rtol
    )
    if recurs > 0.0:
        error = np.maximum(error, recurs)
    single = np.ones(rows * cols, dtype=bool)
    parts: list[tuple[Any, ...]] = []
    rays = rows * cols
    inner = (slice(1, -1), slice(1, -1))
    for group in plan(error, bright, stack_power(error, (amplitude * shown)[inner]), rtol):
        n = group.n
        single[group.pixel] = False
        d_row, d_col = lattice(n * n)
        sub_row = (row[group.pixel, None] + d_row).ravel()
        sub_col = (col[group.pixel, None] + d_col).ravel()
        sub_direction = pixel_directions(camera, sub_row, sub_col)
        sub_hits = tracer.trace((0.0, 0.0, 0.0), sub_direction)
        sub = echoes(scene, tracer, sub_direction, sub_hits, halo)
        sub_spread = np.sqrt((sub.tau_per_row**2 + sub.tau_per_col**2) / 12.0) / n
        parts.append((np.repeat(group.pixel, n * n), sub.amplitude / (n * n), sub.tau, sub_spread))
        rays += len(sub_row)
    empty = (np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), np.zeros(0))
    owner, light, when, width = (np.concatenate([p[i] for p in parts or [empty]]) for i in (0, 1, 2, 3))
    alone = (single, amplitude[inner].ravel(), (tau[inner] + shift).ravel(), spread.ravel())
    returns, first, last = gather_returns(rows * cols, owner, light, when, width, _MERGE_SIGMAS * sigma, alone)
    if not with_truth:
        return DirectScene(returns, {}, rays)
    image = (_cropped(direction, ring), _inner(hits, ring), _inner(echo, ring))
    truth = _truth(scene, *image, returns, first, last, fwhm)
    return DirectScene(returns, {name: _shaped(value, (rows, cols)) for name, value in truth.items()}, rays)


def _probed(pixels: int) -> NDArray[np.int64]:
    """Pixels that are asked with several rays, even over the image: a golden-ratio lattice meets no pattern's period."""
    count = int(np.clip(pixels // _PIXELS_PER_PROBE, 16, 192))
    return ((np.arange(count) + 0.5) * 0.6180339887498949 % 1.0 * pixels).astype(np.int64)


def _recurring_error(
    predicted: Float, lit: NDArray[np.bool_], centre: Float, light: Float, late: Float, rtol: float
) -> float:
    """Error of the centre ray alone by what recurs in all pixels, unseen by it: 0 where several rays agree with it.

    Main arguments, of probed pixels:
        predicted: error by `centre_error`; lit: light in it or beside it; centre: amplitude of the centre ray.
        light, late (pixel, ray): amplitude of the rays, and how far their times are from the centre's tangent plane, in σ.

    Pixels that look smooth are judged: those of which one ray is predicted to be enough, and the smoothest quarter.
    """
    if not lit.any():
        return 0.0
    mine = lit & (predicted <= max(rtol, float(np.quantile(predicted[lit], 0.25))))
    light, centre = light[mine], centre[mine, None]
    both = (light > 0.0) & (centre > 0.0)
    moved = np.where(both, light * np.minimum(np.where(both, late[mine], 0.0), 1.0), 0.0).mean(axis=1)
    brightest = np.maximum(np.maximum(light.max(axis=1), centre[:, 0]), 1e-300)
    found = np.maximum(np.abs(light.mean(axis=1) - centre[:, 0]), moved) / brightest
    measured = float(np.sqrt(np.mean(np.minimum(found, 1.0) ** 2)))
    allowed = _PROBE_SLACK * max(rtol, float(np.sqrt(np.mean(predicted[mine] ** 2))))
    return measured if measured > allowed else 0.0


def _cut(rays: Rays, part: slice) -> Rays:
    return replace(rays, **{f.name: getattr(rays, f.name)[..., part] for f in fields(rays)})


def _cropped(value: NDArray[Any], ring: tuple[int, int]) -> NDArray[Any]:
    """Values (…, n) of the rays of an image and the ring around it: those of the image alone."""
    wide = value.reshape(*value.shape[:-1], *ring)
    return wide[..., 1:-1, 1:-1].reshape(*value.shape[:-1], -1)


def _inner(rays: Rays, ring: tuple[int, int]) -> Rays:
    return replace(rays, **{f.name: _cropped(getattr(rays, f.name), ring) for f in fields(rays)})


def _shaped(value: Any, shape: tuple[int, int]) -> Any:
    return value.reshape(*shape, *value.shape[1:])


def _albedo(scene: Scene, hits: Hits) -> Float:
    """Hemispherical albedo at normal incidence of what each ray hits, texture included; NaN where it hits nothing."""
    whole = np.array([*(item.material.albedo_at_normal() for item in scene.target), np.nan])[hits.target]
    if not any(item.texture for item in scene.target):
        return whole
    gloss = [(i.material.without_diffuse() if i.texture else i.material).albedo_at_normal() for i in scene.target]
    bare = np.array([*gloss, np.nan])[hits.target]
    return np.asarray(bare + hits.shade * (whole - bare))


def _truth(
    scene: Scene, direction: Float, hits: Any, echo: Any, returns: Returns, first: Float, last: Float, fwhm: float
) -> dict[str, Any]:
    """Truth per flat pixel: geometry by the centre ray, first and last return by all sub-samples."""
    hit = hits.target >= 0
    half = C_M_PER_S / (2.0 * group_index(scene.medium, gated_rig(scene).laser.wavelength_m))
    distance = np.where(hit, hits.distance, np.nan)
    albedo = _albedo(scene, hits)
    owners = np.repeat(np.arange(len(hit)), np.diff(returns.start))
    amplitude = np.bincount(owners, weights=returns.amplitude, minlength=len(hit))
    # Half the path is the radial range of a coaxial rig; a bistatic rig's offset is taken from the centre ray.
    offset = np.nan_to_num(echo.tau * half - distance)
    return {
        "truth_range": distance,
        "truth_depth": distance * direction[2],
        "truth_incidence": np.where(hit, np.arccos(np.clip(echo.cos_view, -1.0, 1.0)), np.nan),
        "truth_normal": np.where(hit, hits.normal, np.nan).T.astype(np.float32),
        "truth_albedo": albedo.astype(np.float32),
        "truth_material": hits.target.astype(np.int32),
        "truth_mixed": np.nan_to_num(last - first) > MIXED_FRACTION * fwhm,
        "truth_first": first * half - offset,
        "truth_last": last * half - offset,
        "truth_amplitude": amplitude,
    }
