"""How large scattered light is predicted to be, by closed forms: what the cheaper rungs leave out of *this* scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...optics.correlation.response import lookup
from ...optics.water.beam import beam_halo
from ...optics.water.delay import SHARES
from ...optics.water.halo import forward_share, halo_spread
from ...optics.water.phase_forms import PhaseFunction
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from ..water.delays import Delays, viewed_half_angle
from ..water.ramp import backscatter_electrons
from .gates import gate_tables
from .view import view_of

Float = NDArray[np.float64]

__all__ = ["backscatter_size", "delay_size", "forward_size", "multiple_size", "outside_size"]


#: Targets rarely fill all that is lit: their halo is this share of a wide wall's (drawn scenes of seeds below 100: .5-1).
_FILLED = 0.75


def forward_size(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """(1 + X(0)/I(0)) e^{b r (1 − B)} − 1: halo over unscattered light on the beam's axis, before a wide target.

    X/I is what the beam gains on its way out; the way back gains all that turns forward. On the axis of a wide beam it
    is e^{2 b r (1 − B)} − 1.
    """
    back = np.exp(scene.medium.scattering_per_m * range_m * forward_share(phase))
    return float((1.0 + _gain_out(scene, phase, range_m)) * back - 1.0)


def _gain_out(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """X(0)/I(0), on the beam's axis."""
    b = scene.medium.scattering_per_m
    beam = view_of(scene).lamp
    x = beam_halo(np.zeros(1), beam.profile, beam.edge_rad, phase, b * range_m)
    peak = float(beam.profile(np.zeros(1))[0])
    return float(x[0]) / peak if peak > 0 else float(np.expm1(b * range_m * forward_share(phase)))


def _evenness(scene: Scene, phase: PhaseFunction, range_m: float, half_angle: float) -> float:
    """Halo of the beam over what it is on the axis, mean over what is lit and in view: toward the edge there is less."""
    beam = view_of(scene).lamp
    theta = np.sqrt((np.arange(24) + 0.5) / 24) * half_angle
    x = beam_halo(
        np.concatenate([[0.0], theta]), beam.profile, beam.edge_rad, phase, scene.medium.scattering_per_m * range_m
    )
    return float(x[1:].mean() / x[0]) if x[0] > 0 else 1.0


def backscatter_size(scene: Scene, phase: PhaseFunction, range_m: float, amplitude_e: float, scattered: bool) -> float:
    """Largest backscatter of any slice over the target's largest sample, for the middle pixel's ray.

    Main arguments:
        range_m: where the ray ends.
        amplitude_e: photoelectrons of the target at an open gate; `scattered`: it holds what was scattered on its way out.

    Single scattering over the unscattered return: forward scattering raises both alike.
    """
    rig = gated_rig(scene)
    middle = replace(view_of(scene), camera=rig.camera.model_copy(update={"rows": 1, "cols": 1}))
    tables = gate_tables(scene)
    ramp = rig.delays.after(rig.t0_s)
    delay = np.tile(ramp, len(tables))
    gate = np.repeat(np.arange(len(tables), dtype=np.int32), len(ramp))
    veil = backscatter_electrons(
        scene, middle, phase, tables, gate, delay, np.ones(len(delay)), np.full((1, 1), range_m), None, forward=False
    )
    signal = amplitude_e * max(float(table.value.max()) for table in tables)
    if scattered:
        signal /= 1.0 + _gain_out(scene, phase, range_m)
    return float(veil.max()) / signal if signal > 0 else float("inf")


def outside_size(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """Light of the halo that comes from beyond the widened image of the `scatter` rung, over all light: rms over the image.

    A pixel at x sees the lit target around it up to the beam's edge; what lies beyond twice the image's width is missing.
    Rings of the halo about a pixel: [h within the lit circle] − [h within the widened image], 0 where the beam ends first.
    """
    rig = gated_rig(scene)
    camera = rig.camera
    pixel = camera.pixel_pitch_m / camera.focal_length_m
    half = 0.5 * max(camera.rows, camera.cols) * pixel
    lit = min(view_of(scene).lamp.edge_rad, 0.45 * np.pi)
    spread = halo_spread(phase, scene.medium.scattering_per_m * range_m)
    across = (np.arange(8) + 0.5) / 8 * half  # pixels along a half row
    missing = []
    for x in across:
        # the two sides of the row: the widened image ends at 2·half, the beam at its edge
        sides = [
            float(
                np.maximum(
                    spread.enclosed_within(np.arctan(max(np.tan(lit) + s * x, 1e-6)))
                    - spread.enclosed_within(np.arctan(2.0 * half + s * x)),
                    0.0,
                )
            )
            for s in (-1.0, 1.0)
        ]
        missing.append(0.5 * sum(sides))
    return float(np.sqrt(np.mean(np.square(missing)))) / (1.0 + spread.total)


def delay_size(scene: Scene, phase: PhaseFunction, range_m: float, depth_s: float = 0.0) -> float:
    """‖S′ − S‖/‖S‖ of a wide target's echo over the slices, S′ with the delays of scattered light and S without.

    `depth_s`: standard deviation of a pixel's own times of arrival, which broaden its echo.

    Straight light 1, turned on its way out g = X(0)/I(0), on its way back h (within the view; on its way out turned or not):
    S′ ∝ R + g R∗K_out + h(1 + g) R∗K_back.
    """
    view, medium = view_of(scene), scene.medium
    table = gate_tables(scene)[0]
    half = viewed_half_angle(view)
    share = _evenness(scene, phase, range_m, half)
    out = _FILLED * share * _gain_out(scene, phase, range_m)
    back = _FILLED * share * float(halo_spread(phase, medium.scattering_per_m * range_m).enclosed_within(half))
    late = Delays.of(scene, view, phase, (range_m, range_m))
    width = table.step_s * (table.value.size - 1)
    u = np.linspace(table.start_s - 2.0 * depth_s, table.start_s + 2.0 * (width + depth_s), 768)
    deep = depth_s * np.sqrt(12.0) * ((np.arange(9) + 0.5) / 9 - 0.5)

    def echo(late_s: float) -> Float:
        return np.asarray(np.mean([lookup(table, u - late_s - d) for d in deep], axis=0))

    straight = echo(0.0)
    total = straight.copy()
    for gain, nodes in ((out, late.out), (back * (1.0 + out), late.back)):
        for part, delay, spread in zip(SHARES, nodes.delay_m[0], nodes.spread_m[0], strict=True):
            for side in (-1.0, 1.0):
                total += 0.5 * gain * part * echo((delay + side * spread) * late.per_metre_s)
    even = (1.0 + out + back * (1.0 + out)) * straight
    return float(np.sqrt(np.sum((total - even) ** 2) / np.sum(total**2)))


def multiple_size(delay: float) -> float:
    """What halo, delay and ramp leave out of light that turned several times: about half the delay's size `delay`.

    Not a bound: near the median of traced paths against the `scatter` rung on drawn dark walls. Several turns by large
    angles, the slant of scattered light at the target, and delays of the ramp are in it.
    """
    return 0.5 * delay
