"""Scan of a gated stack: mean signals of its slices over a window of delays."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...scenes.medium_index import group_index
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .gated_instrument import gate_offsets, gated_responses, halo_of, noise_model, path_delay, true_delay
from .instrument import response_centroid_s, response_std_s
from .scan import Elements, Scan, levels, make_scan, need_truth, table_shapes

__all__ = ["gated_scan"]

Float = npt.NDArray[np.float64]


def gated_scan(capture: xr.Dataset, scene: Scene) -> tuple[Scan, Elements]:
    """Scan and elements of a generated stack. Raises InputError if it lacks true amplitude or background."""
    need_truth(capture, "truth_amplitude", "truth_background")
    rig = gated_rig(scene)
    # An error of 1e-4 of the peak is small enough for a ratio of bounds.
    tables = gated_responses(rig, 1e-4)
    used = np.asarray(capture["valid"].values, bool) & np.asarray(capture["laser_on"].values, bool)
    if not used.any():
        used = np.ones_like(used)
    background = np.asarray(capture["truth_background"].values, np.float64)[used]
    delay, gate = true_delay(capture, rig)[used], np.asarray(capture["gate"].values, np.int64)[used]
    width = response_std_s(tables)
    span = 0.5 * float(delay.max() - delay.min()) + math.sqrt(3.0) * width
    middle = 0.5 * float(delay.max() + delay.min()) + float(np.mean([response_centroid_s(table) for table in tables]))
    truth = np.asarray(capture["truth_range"].values, np.float64)
    n_g = group_index(scene.medium, rig.laser.wavelength_m)
    echo = path_delay(truth, rig, n_g)[0] - gate_offsets(rig, (truth.shape[0], truth.shape[1]))
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    halo = halo_of(capture)
    if halo.any():  # moves with the target, as in `gated_bound`
        background = background.copy()
        for k in range(len(delay)):
            shown = correlation.lookup(tables[gate[k]], np.nan_to_num(echo, nan=1.0) - delay[k])
            background[k] = np.maximum(background[k] - halo * np.maximum(shown, 0.0), 0.0)
        amplitude = amplitude + halo
    share, level = levels(background)
    window = (middle - span, middle + span)
    found = make_scan(table_shapes(tables, gate, delay, width), share, window, width, noise_model(rig), echo)
    return found, Elements(echo, amplitude, np.broadcast_to(level, truth.shape), C_M_PER_S / (2.0 * n_g))
