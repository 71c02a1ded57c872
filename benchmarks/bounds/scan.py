"""What the threshold of a capture hangs on, in one form for all modalities: mean signals over a window of delays.

Sample k of an element at delay θ (of the light there and back, s) has the mean μ_k(θ) = α r_k(θ) + β q_k, with α the
element's amplitude, β its background and q the background's shape (mean 1):

    gated      r = R(θ − t_k)                                     one element per pixel
    waveform   r = R(θ + Δ − t_k + step/2)                        one per shot
    amcw       r = 1 + ½ m d cos(ω_f (θ − t0) − φ_k), q = 1       one per shot

Samples are taken as independent, each with the exact likelihood of its detector; single-photon counts as Poisson
counts, without pile-up, which hides counts where light is ample and so where no threshold is.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...optics.constants import C_M_PER_S
from ...optics.correlation import response as correlation
from ...optics.correlation import waveforms
from ...optics.likelihood.fisher_table import information_table
from ...optics.likelihood.model import NoiseModel
from ...scenes.errors import InputError
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import amcw_rig
from ...scenes.rigs.gated import gated_rig
from ...scenes.rigs.waveform import AnalogReadout, shown_pulse, waveform_rig
from ...scenes.scene import Scene
from .amcw import amcw_noise, background_of
from .instrument import (
    gate_offsets,
    gated_responses,
    halo_of,
    noise_model,
    path_delay,
    response_centroid_s,
    response_std_s,
    true_delay,
    true_scene,
)

__all__ = ["PER_WIDTH", "Elements", "Scan", "elements_of", "scan_of"]

Float = npt.NDArray[np.float64]
Shapes = Callable[[Float], tuple[Float, Float, Float]]

PER_WIDTH = 6.0  # delays per width; Gaussian and rectangular R alike are resolved by closed forms between them
_MOST_DELAYS = 3601


@dataclass(frozen=True)
class Scan:
    """`shapes`: θ -> r and its two derivatives (θ, sample). `share` (sample): q. `window_s`: first and last delay of the
    prior; `searched_s`: the same, or its middle part where the window holds more than 600 widths. `width_s`: σ_R, or
    1/(f√12) of the highest modulation frequency. `noise`: None for Poisson counts. `key` names all of it."""

    shapes: Shapes
    share: Float
    window_s: tuple[float, float]
    searched_s: tuple[float, float]
    width_s: float
    noise: NoiseModel | None
    key: str

    def grid(self, per_width: float = PER_WIDTH) -> Float:
        """Even delays over what is searched, at least `per_width` to a width."""
        low, high = self.searched_s
        return np.linspace(low, high, math.ceil(per_width * (high - low) / self.width_s - 1e-9) + 1)

    def information(self, mu: Float) -> Float:
        """J(μ) of one sample, 1/electron²; 0 where there is no light at all."""
        if self.noise is not None:
            return np.asarray(information_table(self.noise)(mu), np.float64)
        return np.where(mu > 0.0, 1.0 / np.where(mu > 0.0, mu, 1.0), 0.0)

    def poisson_mean(self, mu: Float) -> Float:
        """Means of the Poisson counts that match mean and variance: with V = F²μ + v, y/F² + v/F⁴, v the variance without
        light in photoelectrons²."""
        if self.noise is None:
            return np.maximum(mu, 1e-9)
        noise = self.noise
        floor = noise.dark_e + noise.read_noise_e**2 + 1.0 / (12.0 * noise.gain_dn_per_e**2)
        excess = noise.excess_noise_factor
        return np.maximum(mu / excess + floor / (noise.intensifier_gain * excess) ** 2, 1e-9)


@dataclass(frozen=True)
class Elements:
    """Delay [s] (NaN where there is no truth), amplitude and background level per element, and metres per second."""

    delay_s: Float
    amplitude: Float
    level: Float
    scale_m_per_s: float


def _scan(
    shapes: Shapes, share: Float, window: tuple[float, float], width: float, noise: NoiseModel | None, delay: Float
) -> Scan:
    searched, most = window, (_MOST_DELAYS - 1) / PER_WIDTH * width
    if window[1] - window[0] > most:
        # Fewer places to be wrong in: the bound stays one. Where the echoes are, so that they lie inside.
        seen = delay[np.isfinite(delay)]
        middle = float(np.median(seen)) if seen.size else 0.5 * (window[0] + window[1])
        low = min(max(middle - 0.5 * most, window[0]), window[1] - most)
        searched = (low, low + most)
    known = hashlib.sha256(repr((searched, window, width, noise)).encode())
    probe = np.linspace(*searched, 97)
    for part in (share, shapes(probe)[0]):
        known.update(np.ascontiguousarray(part).tobytes())
    return Scan(shapes, share, window, searched, width, noise, known.hexdigest())


def _tables(tables: list[correlation.Table], which: npt.NDArray[np.int64], at: Float, width: float) -> Shapes:
    """R(θ − at_k) of the table of each sample, slope and curvature by differences."""

    def shapes(theta: Float) -> tuple[Float, Float, Float]:
        u = theta[:, None] - at
        r, slope, bend = np.zeros(u.shape), np.zeros(u.shape), np.zeros(u.shape)
        tiny, small = 1e-4 * width, 0.05 * width  # a second difference must span cells of the table
        for g, table in enumerate(tables):
            mine = which == g
            r[:, mine] = np.maximum(correlation.lookup(table, u[:, mine]), 0.0)
            ends = correlation.lookup(table, u[:, mine] + tiny), correlation.lookup(table, u[:, mine] - tiny)
            slope[:, mine] = (ends[0] - ends[1]) / (2.0 * tiny)
            sides = correlation.lookup(table, u[:, mine] + small) + correlation.lookup(table, u[:, mine] - small)
            bend[:, mine] = (sides - 2.0 * r[:, mine]) / small**2
        return r, slope, bend

    return shapes


def _levels(background: Float) -> tuple[Float, Float]:
    """Shape over samples (mean 1) and level per element, of a background (sample, …)."""
    level = background.mean(axis=0)
    shape = background.reshape(background.shape[0], -1).mean(axis=1)
    mean = float(shape.mean())
    return (shape / mean if mean > 0 else np.ones(shape.size)), np.asarray(level)


def _gated(capture: xr.Dataset, scene: Scene) -> tuple[Scan, Elements]:
    rig = gated_rig(scene)
    # 1e-4 of its peak is enough for a ratio of bounds.
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
    share, level = _levels(background)
    window = (middle - span, middle + span)
    found = _scan(_tables(tables, gate, delay, width), share, window, width, noise_model(rig), echo)
    return found, Elements(echo, amplitude, np.broadcast_to(level, truth.shape), C_M_PER_S / (2.0 * n_g))


def _waveform(capture: xr.Dataset, scene: Scene) -> tuple[Scan, Elements]:
    from .waveform import analog_noise

    rig = waveform_rig(scene)
    pulse, lag = shown_pulse(rig)
    step, readout = rig.record.step_s, rig.detector.readout
    table = correlation.tabulate(pulse, waveforms.RectangularGate(step, 1.0), 1e-4)
    width = response_std_s([table])
    half = C_M_PER_S / (2.0 * group_index(scene.medium, rig.laser.wavelength_m))
    time = np.asarray(capture["time"].values, np.float64) - float(json.loads(capture.attrs["rig"])["t0_s"]) + rig.t0_s
    truth = np.asarray(capture["truth_range"].values, np.float64)
    background = np.asarray(capture["truth_background"].values, np.float64).reshape(truth.size, -1)
    share, level = _levels(np.broadcast_to(background, (truth.size, time.size)).T)
    window = (float(time[0]) - 0.5 * step - lag, float(time[-1]) + 0.5 * step - lag)
    noise = analog_noise(readout) if isinstance(readout, AnalogReadout) else None
    at = time - 0.5 * step - lag
    shapes = _tables([table], np.zeros(time.size, np.int64), at, width)
    echo = truth / half
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    return _scan(shapes, share, window, width, noise, echo), Elements(echo, amplitude, level, half)


def _amcw(capture: xr.Dataset, scene: Scene) -> tuple[Scan, Elements]:
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
    share, level = _levels(np.broadcast_to(background, (truth.size, omega.size)).T)
    window = (rig.range_window_m[0] / half, rig.range_window_m[1] / half)
    width = 1.0 / (float(frequency.max()) * math.sqrt(12.0))
    echo = truth / half
    amplitude = np.asarray(capture["truth_amplitude"].values, np.float64)
    return _scan(shapes, share, window, width, noise, echo), Elements(echo, amplitude, level, half)


_OF = {"gated": _gated, "waveform": _waveform, "amcw": _amcw}


def _read(capture: xr.Dataset) -> tuple[Scan, Elements]:
    scene = true_scene(capture)
    modality = str(capture.attrs.get("modality"))
    if modality not in _OF:
        raise InputError(
            "No threshold is known for such captures.", where="modality", value=modality, allowed=", ".join(_OF)
        )
    wanted = ("truth_amplitude",) if modality == "amcw" else ("truth_amplitude", "truth_background")
    if any(name not in capture for name in wanted):
        raise InputError("The capture does not tell its amplitudes.", where="truth_amplitude, truth_background")
    return _OF[modality](capture, scene)


def scan_of(capture: xr.Dataset) -> Scan:
    """The scan of a generated capture. Raises InputError where it lacks its true scene or amplitudes."""
    return _read(capture)[0]


def elements_of(capture: xr.Dataset) -> tuple[Scan, Elements]:
    """The scan and its elements. Raises InputError as `scan_of`."""
    return _read(capture)
