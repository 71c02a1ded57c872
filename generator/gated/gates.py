"""The gates of a gated rig: the tabulated responses R(u) of pulse and gate, their width, and the gate's delay in each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...optics.correlation import waveforms
from ...optics.correlation.gate_maps import gate_offset_map
from ...optics.correlation.response import Table, correlation_support, lookup
from ...scenes.rigs.gated import gated_rig
from ...scenes.sampling import optics_gate, optics_pulse, response_table
from ...scenes.scene import Scene
from ..random import jitter_about_mean

__all__ = ["gate_offset", "gate_offset_image", "gate_tables", "response_width_s"]

Float = NDArray[np.float64]

#: Accuracy of the tabulated R, relative to its peak.
_TABLE_RTOL = 1e-5


def gate_tables(scene: Scene) -> list[Table]:
    """R(u) of every gate, with the pulse broadened by the jitter of single shots about the mean of their slice."""
    rig = gated_rig(scene)
    pulse = waveforms.broadened(
        optics_pulse(rig.laser.pulse), jitter_about_mean(rig.laser.jitter_shot_s, rig.pulses_per_slice)
    )
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


def gate_offset(scene: Scene) -> Float | None:
    """Extra delay of the gate in each pixel (rows·cols) [s]; None where all open together."""
    image = gate_offset_image(scene)
    return None if image is None else image.ravel()


def gate_offset_image(scene: Scene) -> Float | None:
    """As `gate_offset`, (rows, cols)."""
    rig = gated_rig(scene)
    if rig.gate_map is None:
        return None
    return gate_offset_map(rig.camera.rows, rig.camera.cols, rig.gate_map.iris_s, rig.gate_map.skew_s)
