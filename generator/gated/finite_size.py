"""How much a lens and a lamp of finite size would change the direct light: closed forms on the direct rung's own image.

The lens blurs what lies out of focus over a disc of radius ρ = (f/2N) abs(1/z − 1/z_f) f/p pixels, the circle of confusion. The
image is taken apart by range, because an edge between two ranges changes times where it does not change brightness; each
part is blurred by its disc, its light taken as even over each pixel, and the change is stated relative to the image, rms.
What a surface in front hides, and light from beyond the image, is not followed.

The lamp is sampled at points of its disc, by rays: each gives light ∝ I(θ) cosθ_i e^(−cr)/r² (a surface is as bright from any
distance), later by δ than the middle. With m₀ the change of the light, m₁ = ⟨δ⟩ and m₂ = ⟨δ²⟩ weighed by light, the change of an
echo R is m₀ R − m₁ R' + m₂ R''/2, its square

    ε² = m₀² − m₀ m₂ a + m₂² b/4 + m₁² a,     a = ∫R'²/∫R² = −∫R R''/∫R²,  b = ∫R''²/∫R²,

summed over pixels with their light squared. The surface's gloss is not followed: it is taken as matt.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...optics.constants import C_M_PER_S
from ...optics.illumination import beam_rotation
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..rays.subsampling import lattice
from ..rays.trace import Tracer, pixel_directions
from .direct import DirectScene
from .gates import gate_tables, response_width_s
from .view import view_of

__all__ = ["defocus_size", "finite_size", "is_finite", "lamp_size"]

Float = NDArray[np.float64]

#: Parts of the image by range, each at least a σ of R deep.
_MOST_PARTS = 24
#: Points of the lamp, and pixels at which they are traced.
_LAMP_POINTS = 32
#: Points of the circle of confusion.
_DISC_POINTS = 2048
_PIXELS = 4096


def is_finite(scene: Scene) -> bool:
    """Whether the scene's lens or lamp is more than a point."""
    rig = gated_rig(scene)
    return rig.camera.focus_distance_m is not None or rig.laser.source_radius_m > 0.0


def finite_size(scene: Scene, direct: DirectScene, tracer: Tracer | None = None) -> tuple[float, str]:
    """(change of the stack relative to the stack, rms; basis): 0 where lens and lamp are points."""
    if not is_finite(scene):
        return 0.0, "point source and pinhole, as the scene says"
    blur, radius = defocus_size(scene, direct)
    lamp = lamp_size(scene, direct, tracer)
    return math.hypot(blur, lamp), f"circle of confusion of {radius:.2g} px: {blur:.2g}; penumbra and delay: {lamp:.2g}"


def defocus_size(scene: Scene, direct: DirectScene) -> tuple[float, float]:
    """(relative change of the image by the lens's blur, largest radius of the circle of confusion in pixels)."""
    rig = gated_rig(scene)
    camera = rig.camera
    amplitude = np.asarray(direct.truth["truth_amplitude"], dtype=np.float64)
    depth, distance = (np.asarray(direct.truth[f"truth_{name}"], np.float64) for name in ("depth", "range"))
    seen = np.isfinite(depth) & (amplitude > 0.0)
    if camera.focus_distance_m is None or not seen.any():
        return 0.0, 0.0
    pixels = 0.5 * camera.focal_length_m**2 / (camera.f_number * camera.pixel_pitch_m)
    radius = pixels * np.abs(1.0 / np.where(seen, depth, 1.0) - 1.0 / camera.focus_distance_m)
    sigma_m = response_width_s(scene)[0] * 0.5 * C_M_PER_S / group_index(scene.medium, rig.laser.wavelength_m)
    low, high = float(distance[seen].min()), float(distance[seen].max())
    parts = min(int((high - low) / sigma_m) + 1, _MOST_PARTS)
    where = np.where(seen, (distance - low) / max(high - low, 1e-12) * (parts - 1), 0.0)
    largest = float(radius[seen].max())
    pad = min(math.ceil(largest) + 1, 2 * max(amplitude.shape))
    change = whole = 0.0
    for part in range(parts):
        # Hats, so that a slope runs from one part into the next without an edge.
        light = np.where(seen, amplitude * np.maximum(1.0 - np.abs(where - part), 0.0), 0.0)
        if not light.any():
            continue
        wide = np.pad(light, pad, mode="symmetric")
        disc = _disc(float(np.sum(light * radius) / light.sum()), wide.shape)
        blurred = np.fft.irfft2(np.fft.rfft2(wide) * np.fft.rfft2(disc), wide.shape)[pad:-pad, pad:-pad]
        change += float(np.sum((blurred - light) ** 2))
        whole += float(np.sum(light**2))
    return math.sqrt(change / whole), largest


def _disc(radius: float, shape: tuple[int, ...]) -> Float:
    """What light of pixel (0, 0), even over it, gives to every pixel (cyclic) under a disc of this radius in pixels: a shift by a
    part of a pixel shares it out linearly."""
    share, turn = (value + 0.5 for value in lattice(_DISC_POINTS))
    out = np.zeros(shape)
    y, x = radius * np.sqrt(share) * np.sin(2 * np.pi * turn), radius * np.sqrt(share) * np.cos(2 * np.pi * turn)
    top, left = np.floor(y).astype(np.int64), np.floor(x).astype(np.int64)
    fy, fx = y - top, x - left
    for row, col, weight in (
        (top, left, (1 - fy) * (1 - fx)), (top, left + 1, (1 - fy) * fx),
        (top + 1, left, fy * (1 - fx)), (top + 1, left + 1, fy * fx),
    ):  # fmt: skip
        np.add.at(out, (row % shape[0], col % shape[1]), weight / _DISC_POINTS)
    return out


def lamp_size(scene: Scene, direct: DirectScene, tracer: Tracer | None = None) -> float:
    """Relative change of the stack by the lamp's size: shadows, delays, and the beam's own width."""
    rig = gated_rig(scene)
    laser, camera, lamp = rig.laser, rig.camera, view_of(scene).lamp
    distance = np.asarray(direct.truth["truth_range"], dtype=np.float64).ravel()
    pick = np.flatnonzero(np.isfinite(distance))
    if laser.source_radius_m == 0.0 or pick.size == 0:
        return 0.0
    pick = pick[:: max(pick.size // _PIXELS, 1)]
    row, col = np.divmod(pick, camera.cols)
    point = pixel_directions(camera, row, col) * distance[pick]
    normal = np.asarray(direct.truth["truth_normal"], dtype=np.float64).reshape(-1, 3)[pick].T
    matt = np.asarray(direct.truth["truth_albedo"], dtype=np.float64).ravel()[pick]
    matt = matt * np.exp(-scene.medium.attenuation_per_m * distance[pick])
    tracer = tracer or Tracer(scene)
    frame = beam_rotation(laser.illumination.offset_rad)
    share, turn = (value + 0.5 for value in lattice(_LAMP_POINTS))
    spot = laser.source_radius_m * np.sqrt(share) * np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])

    def lit(place: Float) -> tuple[Float, Float]:
        beam = point - place[:, None]
        far = np.sqrt(np.einsum("in,in->n", beam, beam))
        beam /= far
        light = matt * lamp.intensity(beam) * np.exp(-scene.medium.attenuation_per_m * far) / far**2
        light *= np.maximum(-np.einsum("in,in->n", normal, beam), 0.0)
        return np.where(tracer.visible(point, (place[0], place[1], place[2])), light, 0.0), far

    middle = np.asarray(laser.position_m, dtype=np.float64)
    before, near = lit(middle)
    per_metre = group_index(scene.medium, laser.wavelength_m) / C_M_PER_S
    m0, m1, m2 = -before, np.zeros(pick.size), np.zeros(pick.size)
    for x, y in spot.T:
        light, far = lit(middle + frame[:, 0] * x + frame[:, 1] * y)
        late = (far - near) * per_metre
        m0 += light / _LAMP_POINTS
        m1 += light * late / _LAMP_POINTS
        m2 += light * late**2 / _LAMP_POINTS
    # An echo that leaves R altogether changes by no more than itself and what was there.
    table = gate_tables(scene)[0]
    whole = float(np.sum(np.square(table.value)))
    a = float(np.sum(np.square(table.slope))) / whole
    b = float(np.sum(np.square(np.gradient(table.slope, table.step_s)))) / whole
    change = np.minimum(m0**2 - m0 * m2 * a + 0.25 * m2**2 * b + m1**2 * a, (m0 + before) ** 2 + before**2)
    return math.sqrt(float(change.sum() / max(float(np.sum(before**2)), 1e-300)))
