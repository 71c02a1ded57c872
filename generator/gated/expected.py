"""The expectation of a gated capture: direct light, and what the rung adds of scattered and multiply reflected light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..effect import no_light
from ..model import Expected
from ..request import Request
from .direct import DirectScene, render_direct
from .full import SAMPLING, add_remainder
from .scatter import ScatterScene, forward_electrons, halo_electrons, render_scatter, scattered_electrons
from .screen import behind_screen
from .stack import expected_electrons, slice_coordinates, slice_settings

__all__ = ["expect"]

Float = NDArray[np.float64]
Stack = NDArray[np.float32]

#: The halo of the full rung's truth is not sampled more finely than this.
_HALO_RTOL = 0.02


@dataclass(frozen=True, eq=False)
class _Light:
    """The light of a capture. `electrons` (slice, row, col): all of it, without dark current; `background`: what carries other
    ranges than the pixel's own, (slice, row, col), or (slice) where it is even over the image; `ambient`:
    photoelectrons (slice)."""

    electrons: Stack
    background: NDArray[Any]
    ambient: Float
    direct: DirectScene
    scatter: ScatterScene | None
    warnings: tuple[str, ...]
    traced: dict[str, Any]
    truth: dict[str, Any]


def expect(scene: Scene, request: Request) -> Expected[DirectScene]:
    """Photoelectrons, coordinates and truth at the request's rung."""
    coords = slice_coordinates(scene)
    light = _light(scene, request, coords)
    truth = _truth(scene, request, light)
    kept = {name: value for name, value in coords.items() if name not in ("setting", "actual")}
    return Expected(
        light.electrons, kept | {"delay": coords["setting"]}, truth, light.direct.rays, light.direct,
        light.warnings + _folded(scene, light.direct),
        light.traced,
    )  # fmt: skip


def _light(scene: Scene, request: Request, coords: dict[str, Any]) -> _Light:
    """Direct light; then the screen's, the water's or the traced remainder, which belong to the background."""
    seed, key, rung = request.seed, request.capture_key, request.rung
    # Rays and paths of the full rung share its error.
    share = SAMPLING * request.error if rung == "full" else request.error
    scatter = render_scatter(scene, request.error, request.tracer) if rung == "scatter" else None
    direct = render_direct(scene, share, request.tracer) if scatter is None else scatter.direct
    screen: DirectScene | None = None
    if gated_rig(scene).screen is not None:
        direct, screen = behind_screen(scene, direct, share)
    light, ambient = expected_electrons(scene, direct, coords, seed, key, share)
    level = ambient.astype(np.float32)[:, None, None]
    if rung == "full":
        settings = slice_settings(scene, coords, seed, key)
        background, traced, truth = add_remainder(
            scene, light, ambient, coords["gate"], *settings, share, seed, key, direct.truth, request.truth_components
        )
        warnings = _dark(scene, light, ambient, coords) + _short(scene, traced, request.error)
        return _Light(light, background, ambient, direct, None, warnings, traced, dict(direct.truth) | truth)
    if screen is not None:
        veil = expected_electrons(scene, screen, coords, seed, key)[0] - level
    elif scatter is not None and scatter.phase is not None:
        return _scattered(scene, request, scatter, light, ambient, coords)
    else:
        return _Light(
            light, ambient, ambient, direct, scatter, _dark(scene, light, ambient, coords), {}, dict(direct.truth)
        )
    light += veil
    return _Light(
        light, level + veil, ambient, direct, scatter, _dark(scene, light, ambient, coords), {}, dict(direct.truth)
    )


def _scattered(
    scene: Scene, request: Request, scatter: ScatterScene, light: Stack, ambient: Float, coords: dict[str, Any]
) -> _Light:
    """The scatter rung's light: `light` of each pixel's own surface, scattered forward or not, and what others and the water add.

    truth_amplitude is what came unscattered, as on every rung; all else is background, and its target's part truth_halo.
    """
    seed, key = request.seed, request.capture_key
    straight = render_direct(scene, request.error, request.tracer)
    own = expected_electrons(scene, straight, coords, seed, key, request.error)[0]
    own -= ambient.astype(np.float32)[:, None, None]
    light += scattered_electrons(scene, scatter, coords["gate"], *slice_settings(scene, coords, seed, key))
    truth = dict(scatter.direct.truth) | {"truth_amplitude": straight.truth["truth_amplitude"]}
    turned = np.asarray(scatter.direct.truth["truth_amplitude"], np.float64) - truth["truth_amplitude"]
    truth["truth_halo"] = np.maximum(turned, 0.0) + halo_electrons(scatter)
    # Rays of both passes differ where a pixel is mixed: what is straight is part of the whole.
    background = np.maximum(light - own, ambient.astype(np.float32)[:, None, None])
    return _Light(light, background, ambient, scatter.direct, scatter, _dark(scene, light, ambient, coords), {}, truth)


def _truth(scene: Scene, request: Request, light: _Light) -> dict[str, Any]:
    """Truth of the direct light, and the halo, the background and the expectation, each with the sensor's dark current."""
    detector = gated_rig(scene).detector
    truth = light.truth
    if not request.truth_instances:
        truth.pop("truth_instance", None)
    if request.rung == "full" and scene.medium.scattering_per_m > 0:
        own = np.asarray(light.direct.truth["truth_amplitude"], np.float64)
        truth["truth_halo"] = forward_electrons(scene, own, max(request.error, _HALO_RTOL), request.tracer)
    # Behind an intensifier dark electrons join after the gain: they are no photoelectrons.
    dark = detector.dark_current_e_per_s * detector.exposure_s if detector.intensifier is None else 0.0
    truth["truth_background"] = light.background + light.background.dtype.type(dark)
    if request.truth_components:
        truth |= _components(request, light) | {"truth_ambient": light.ambient + dark}
    if request.truth_electrons:
        truth["truth_electrons"] = light.electrons + np.float32(dark)
    return truth


def _components(request: Request, light: _Light) -> dict[str, Stack]:
    """What the lamp's light is the sum of, on the rungs that are not traced: their background is ambient and scattered light."""
    if request.rung == "full":
        return {}  # its paths bring them
    level = light.ambient.astype(np.float32)[:, None, None]
    if light.scatter is None:  # a screen reflects, too
        return {"truth_direct": light.electrons - level}
    shape = (len(level), 1, 1)
    background = light.background.reshape(shape) if light.background.ndim == 1 else light.background
    scattered = np.broadcast_to(background - level, light.electrons.shape).astype(np.float32)
    return {"truth_direct": light.electrons - level - scattered, "truth_scattered": scattered}


def _dark(scene: Scene, light: Stack, ambient: Float, coords: dict[str, Any]) -> tuple[str, ...]:
    """The warning of a stack that holds nothing but ambient light; empty where there is more."""
    signal = light.max(axis=(1, 2)) - ambient
    if signal.max() > 0:
        return ()
    window = coords["actual"][coords["laser_on"]]
    return (no_light(scene, "slice", f"every gate (delays {window.min():.4g} … {window.max():.4g} s)"),)


def _folded(scene: Scene, direct: DirectScene) -> tuple[str, ...]:
    """The warning of echoes that come back after the next pulse has left; empty where none do."""
    rig = gated_rig(scene)
    period = rig.detector.exposure_s / rig.pulses_per_slice
    per_metre = 2.0 * group_index(scene.medium, rig.laser.wavelength_m) / C_M_PER_S
    lit = np.asarray(direct.truth["truth_amplitude"]) > 0
    far = np.asarray(direct.truth["truth_range"], dtype=np.float64)[lit]
    latest = float(np.nanmax(far, initial=0.0)) * per_metre
    if latest < period:
        return ()
    return (
        f"{scene.name}: echoes return {latest:.3g} s after their pulse, and pulses leave every {period:.3g} s "
        "(exposure_s/pulses_per_slice): those of earlier pulses would fall into the gates, and are not modelled.",
    )


def _short(scene: Scene, traced: dict[str, Any], rtol: float) -> tuple[str, ...]:
    """The warning of too few paths; empty where they suffice."""
    if traced["reached"]:
        return ()
    return (
        f"{scene.name}: {traced['samples_per_pixel']} paths per pixel leave a standard error of "
        f"{traced['standard_error']:.2g} of the stack, more than rtol {rtol:g}.",
    )
