"""The `direct` rung: one bounce, deterministic sub-pixel rays, exact times.

Returns the echoes of every pixel (`Returns`) and the truth; the stack follows by `render_stack`.

Neighbouring centre rays show where one ray is not enough. They miss what recurs in every pixel (slats, a net, fine texture); so
some pixels that look smooth are probed with several rays too, and where those disagree all pixels get more. The limit of
that: structure smaller than a pixel that only few pixels hold, and that no centre ray near it meets, is missed.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..rays.echo import Echoes, Halo, echoes
from ..rays.lamp import Lamp
from ..rays.returns import Returns
from ..rays.subsampling import centre_error, lattice, plan, stack_power
from ..rays.trace import Hits, Tracer, pixel_directions
from ..rays.view import View
from .gates import gate_tables, response_width_s
from .slice_view import slice_view
from .sub_pixels import sub_pixel_returns
from .view import view_of

__all__ = ["MIXED_FRACTION", "DirectScene", "render_direct"]

Float = NDArray[np.float64]
Rays = TypeVar("Rays", Hits, Echoes)

#: Samples within this many σ of R become one return.
_MERGE_SIGMAS = 0.25
#: The contract: a pixel is mixed where its sub-samples span over this fraction of R's full width at half maximum.
MIXED_FRACTION = 0.05
#: One pixel in so many is probed with several rays; rays for each, and by how much these may disagree with its centre.
_PIXELS_PER_PROBE = 32
_PROBE_RAYS = 9
_PROBE_SLACK = 4.0


@dataclass(frozen=True)
class DirectScene:
    """The direct light of a scene: `returns` over flat pixels, and `truth` arrays by name."""

    returns: Returns
    truth: dict[str, Any]
    rays: int


@dataclass(frozen=True, eq=False)
class _Image:
    """Rays through the centres of an image's pixels and of one ring around it, which shows edges in the outermost pixels:
    their `direction` (3, n), `hits` and `echo`, flat over `ring` = (rows + 2, cols + 2). `probed`: flat pixels with several
    rays each, and the echoes of these, `probes` (pixel, ray) flat."""

    direction: Float
    hits: Hits
    echo: Echoes
    ring: tuple[int, int]
    probed: NDArray[np.int64]
    probes: Echoes

    def shaped(self, value: Float) -> Float:
        """A value of the centre rays as (rows + 2, cols + 2)."""
        return value.reshape(self.ring)


def _image(scene: Scene, view: View[Lamp], tracer: Tracer, halo: Halo | None) -> _Image:
    rows, cols = view.camera.rows, view.camera.cols
    ring = (rows + 2, cols + 2)
    wide_row, wide_col = (a.ravel() - 1 for a in np.mgrid[: ring[0], : ring[1]])
    probed = _probed(rows * cols)
    near_row, near_col = (
        (at[:, None] + d).ravel() for at, d in zip(np.divmod(probed, cols), lattice(_PROBE_RAYS), strict=True)
    )
    direction = pixel_directions(
        view.camera, np.concatenate([wide_row, near_row]), np.concatenate([wide_col, near_col])
    )
    hits = tracer.trace((0.0, 0.0, 0.0), direction)
    echo = echoes(scene, view, tracer, direction, hits, halo)
    count = wide_row.size
    return _Image(
        direction[:, :count], _cut(hits, slice(count)), _cut(echo, slice(count)), ring, probed,
        _cut(echo, slice(count, None)),
    )  # fmt: skip


def render_direct(
    scene: Scene,
    rtol: float,
    tracer: Tracer | None = None,
    halo: Halo | None = None,
    *,
    with_truth: bool = True,
) -> DirectScene:
    """Trace the scene and gather its echoes.

    Main arguments:
        scene: target, medium and rig.
        rtol: relative error ε of the stack aimed at by the sub-pixel sampling.
    Other arguments:
        tracer: reuse an earlier one (same target).
        halo: intensity added to the beam's own, as in `echoes`.
        with_truth: also gather the truth; without it `truth` is empty.
    """
    tracer, view = tracer or Tracer(scene), view_of(scene)
    rows, cols = view.camera.rows, view.camera.cols
    sigma, fwhm = response_width_s(scene)
    image = _image(scene, view, tracer, halo)
    echo, inner = image.echo, (slice(1, -1), slice(1, -1))
    amplitude, tau, per_row, per_col = (
        image.shaped(a) for a in (echo.amplitude, echo.tau, echo.tau_per_row, echo.tau_per_col)
    )
    shown, weight = slice_view(scene, gate_tables(scene), sigma, tau)
    error, bright, shift, spread = centre_error(amplitude, tau, per_row, per_col, sigma, weight)
    recurs = _recurring_error(image, error.ravel(), bright.ravel() > 0.0, sigma, rtol)
    if recurs > 0.0:
        error = np.maximum(error, recurs)
    groups = plan(error, bright, stack_power(error, (amplitude * shown)[inner]), rtol)
    alone = (amplitude[inner].ravel(), (tau[inner] + shift).ravel(), spread.ravel())
    returns, first, last, more = sub_pixel_returns(scene, view, tracer, halo, groups, alone, _MERGE_SIGMAS * sigma)
    rays = rows * cols + more
    if not with_truth:
        return DirectScene(returns, {}, rays)
    centre = (_cropped(image.direction, image.ring), _inner(image.hits, image.ring), _inner(echo, image.ring))
    truth = _truth(scene, *centre, returns, first, last, fwhm) | {"truth_instance": tracer.instances(centre[1])}
    return DirectScene(returns, {name: _shaped(value, (rows, cols)) for name, value in truth.items()}, rays)


def _probed(pixels: int) -> NDArray[np.int64]:
    """Flat pixels that are probed with several rays, even over the image: a golden-ratio lattice meets no pattern's period."""
    count = int(np.clip(pixels // _PIXELS_PER_PROBE, 16, 192))
    return ((np.arange(count) + 0.5) * 0.6180339887498949 % 1.0 * pixels).astype(np.int64)


def _recurring_error(image: _Image, error: Float, lit: NDArray[np.bool_], sigma_s: float, rtol: float) -> float:
    """Error of the centre ray alone by what recurs in all pixels, unseen by it: 0 where several rays agree with it.

    Main arguments, of flat pixels:
        error: by `centre_error`; lit: whether there is light in the pixel or beside it.
        sigma_s: σ of R.

    Pixels that look smooth are judged: those for which one ray is predicted to be enough, and the smoothest quarter.
    """
    d_row, d_col = lattice(_PROBE_RAYS)
    row, col = np.divmod(image.probed, image.ring[1] - 2)
    inside = (row + 1, col + 1)
    tau, per_row, per_col, centre = (
        image.shaped(a)[inside][:, None]
        for a in (image.echo.tau, image.echo.tau_per_row, image.echo.tau_per_col, image.echo.amplitude)
    )
    plane = tau + per_row * d_row + per_col * d_col
    late = np.abs(image.probes.tau.reshape(plane.shape) - plane) / sigma_s
    light = image.probes.amplitude.reshape(plane.shape)
    predicted, lit = error[image.probed], lit[image.probed]
    if not lit.any():
        return 0.0
    smooth = lit & (predicted <= max(rtol, float(np.quantile(predicted[lit], 0.25))))
    light, centre = light[smooth], centre[smooth]
    both = (light > 0.0) & (centre > 0.0)
    moved = np.where(both, light * np.minimum(np.where(both, late[smooth], 0.0), 1.0), 0.0).mean(axis=1)
    brightest = np.maximum(np.maximum(light.max(axis=1), centre[:, 0]), 1e-300)
    change = np.maximum(np.abs(light.mean(axis=1) - centre[:, 0]), moved) / brightest
    measured = float(np.sqrt(np.mean(np.minimum(change, 1.0) ** 2)))
    allowed = _PROBE_SLACK * max(rtol, float(np.sqrt(np.mean(predicted[smooth] ** 2))))
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
