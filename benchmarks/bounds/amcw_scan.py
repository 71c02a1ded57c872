"""Scan of amplitude-modulated ranging: mean samples over the window of ranges."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import amcw_rig
from ...scenes.scene import Scene
from .amcw import amcw_noise, background_of
from .scan import Elements, Scan, levels, make_scan, need_truth

__all__ = ["amcw_scan"]

Float = npt.NDArray[np.float64]


def amcw_scan(capture: xr.Dataset, scene: Scene) -> tuple[Scan, Elements]:
    """Scan and elements of a generated capture. Raises InputError if it lacks its true amplitude."""
    need_truth(capture, "truth_amplitude")
    rig = amcw_rig(scene)
    modulation, detector = rig.modulation, rig.detector
    half = C_M_PER_S / (2.0 * group_index(scene.medium, rig.laser.wavelength_m))
    frequency = np.asarray(modulation.frequencies_hz, np.float64)
    omega = 2.0 * np.pi * np.repeat(frequency, modulation.phase_steps)
    phase = np.tile(2.0 * np.pi * np.arange(modulation.phase_steps) / modulation.phase_steps, frequency.size)
    depth = 0.5 * rig.laser.modulation_depth * detector.demodulation_contrast
    t0 = rig.t0_s

    def shapes(theta: Float) -> tuple[Float, Float, Float]:
        turn = omega * (theta[:, None] - t0) - phase
        wave = depth * np.cos(turn)
        return 1.0 + wave, -depth * omega * np.sin(turn), -(omega**2) * wave

    noise = amcw_noise(rig)
    truth = np.asarray(capture["truth_range"].values, np.float64)
    background = background_of(capture, rig)
    share, level = levels(np.broadcast_to(background, (truth.size, omega.size)).T)
    window = (rig.range_window_m[0] / half, rig.range_window_m[1] / half)
    width = 1.0 / (float(frequency.max()) * math.sqrt(12.0))
    echo = truth / half
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    return make_scan(shapes, share, window, width, noise, echo), Elements(echo, amplitude, level, half)
