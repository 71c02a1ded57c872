"""Scan of a recorded pulse: mean signals of its samples over a window of delays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...optics.correlation import waveforms
from ...scenes.medium_index import group_index
from ...scenes.rigs.waveform import AnalogReadout, shown_pulse, waveform_rig
from ...scenes.scene import Scene
from .instrument import response_std_s, true_time
from .scan import Elements, Scan, levels, make_scan, need_truth, table_shapes
from .waveform import analog_noise, record_start

__all__ = ["waveform_scan"]

Float = npt.NDArray[np.float64]


def waveform_scan(capture: xr.Dataset, scene: Scene) -> tuple[Scan, Elements]:
    """Scan and elements of a generated record. Raises InputError if it lacks true amplitude or background."""
    need_truth(capture, "truth_amplitude", "truth_background")
    rig = waveform_rig(scene)
    pulse, lag = shown_pulse(rig)
    step, readout = rig.record.step_s, rig.detector.readout
    table = correlation.tabulate(pulse, waveforms.RectangularGate(step, 1.0), 1e-4)
    width = response_std_s([table])
    half = C_M_PER_S / (2.0 * group_index(scene.medium, rig.laser.wavelength_m))
    time = true_time(capture, "time", rig.t0_s)
    truth = np.asarray(capture["truth_range"].values, np.float64)
    background = np.asarray(capture["truth_background"].values, np.float64).reshape(truth.size, -1)
    share, level = levels(np.broadcast_to(background, (truth.size, time.size)).T)
    window = (float(time[0]) - 0.5 * step - lag, float(time[-1]) + 0.5 * step - lag)
    noise = analog_noise(readout) if isinstance(readout, AnalogReadout) else None
    at = time - 0.5 * step - lag
    shapes = table_shapes([table], np.zeros(time.size, np.int64), at, width)
    echo = truth / half - record_start(capture)
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    return make_scan(shapes, share, window, width, noise, echo), Elements(echo, amplitude, level, half)
