"""How large scattered light is predicted to be, by closed forms: what the cheaper rungs leave out of *this* scene."""

from __future__ import annotations

import numpy as np

from ..optics.constants import C_M_PER_S
from ..optics.correlation import correlation_support
from ..optics.phase_forms import PhaseFunction
from ..optics.phase_function import asymmetry, mean_square_angle
from ..optics.scatter_beam import beam_halo
from ..optics.scatter_halo import forward_share, halo_spread
from ..scenes.declare import group_index, optics_gate, optics_pulse
from ..scenes.scene import Scene, gated_rig
from .direct import gate_tables
from .scatter_ramp import backscatter_electrons, beam_edge, beam_profile

__all__ = ["backscatter_size", "delay_size", "forward_size", "multiple_size", "outside_size"]


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
    spec = gated_rig(scene).laser.illumination
    edge = beam_edge(spec)
    x = beam_halo(np.zeros(1), lambda t: beam_profile(spec, t), edge, phase, b * range_m)
    peak = float(beam_profile(spec, np.zeros(1))[0])
    return float(x[0]) / peak if peak > 0 else float(np.expm1(b * range_m * forward_share(phase)))


def backscatter_size(scene: Scene, phase: PhaseFunction, range_m: float, amplitude_e: float, scattered: bool) -> float:
    """Largest backscatter of any slice over the target's largest sample, for the middle pixel's ray.

    Main arguments:
        range_m: where the ray ends.
        amplitude_e: photoelectrons of the target at an open gate; `scattered`: it holds what was scattered on its way out.

    Single scattering over the unscattered return: forward scattering raises both alike.
    """
    rig = gated_rig(scene)
    camera = rig.camera.model_copy(update={"rows": 1, "cols": 1})
    single = scene.model_copy(update={"rig": rig.model_copy(update={"camera": camera, "gate_map": None})})
    tables = gate_tables(scene)
    ramp = rig.t0_s + rig.delays.start_s + rig.delays.step_s * np.arange(rig.delays.count)
    delay = np.tile(ramp, len(tables))
    gate = np.repeat(np.arange(len(tables), dtype=np.int32), len(ramp))
    veil = backscatter_electrons(
        single, phase, tables, gate, delay, np.ones(len(delay)), np.full((1, 1), range_m), None, forward=False
    )
    signal = amplitude_e * max(float(table.value.max()) for table in tables)
    if scattered:
        signal /= 1.0 + _gain_out(scene, phase, range_m)
    return float(veil.max()) / signal if signal > 0 else float("inf")


def outside_size(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """[h beyond θ]/(1 + all h), θ = half the image's width: what the widened image of the `scatter` rung does not hold
    for a pixel at the edge, of the light that comes back from a wide target."""
    camera = gated_rig(scene).camera
    half = np.arctan(0.5 * max(camera.rows, camera.cols) * camera.pixel_pitch_m / camera.focal_length_m)
    spread = halo_spread(phase, scene.medium.scattering_per_m * range_m)
    return float((spread.total - spread.enclosed_within(half)) / (1.0 + spread.total))


def delay_size(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """Mean delay of forward-scattered against straight light, both ways, in widths of R, times its share of the light.

    Turning by ψ at the fraction t of a way r lengthens it by r t(1 − t)ψ²/2: on the mean b r · r⟨ψ²⟩/12 a way.
    """
    b = scene.medium.scattering_per_m
    rig = gated_rig(scene)
    longer = 2.0 * b * forward_share(phase) * range_m**2 * mean_square_angle(phase) / 12.0
    late = longer * group_index(scene.medium, rig.laser.wavelength_m) / C_M_PER_S
    low, high = correlation_support(optics_pulse(rig.laser.pulse), optics_gate(rig.gates[0]))
    return float(late / (0.25 * (high - low)))


def multiple_size(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """1 − e^{−2 b (1 − g) r}: the chance of a turn by a large angle on the way there and back."""
    return float(-np.expm1(-2.0 * scene.medium.scattering_per_m * (1.0 - asymmetry(phase)) * range_m))
