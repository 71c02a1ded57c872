"""What the gated estimators need of the declared rig, worked out when it is first used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from ....optics.constants import C_M_PER_S
from ....optics.correlation.gate_maps import gate_offset_map
from ....scenes.errors import InputError
from ...declared import check_keys
from ...response import Response, correlate_samples
from ...rig import Amplifier, Converter, DeclaredRig, read_rig
from .declared import GATED_KEYS

__all__ = ["READ_NOISE", "Dark", "Instrument", "instrument_of"]

Float = npt.NDArray[np.float64]

#: Place of the read noise, which slices without laser light show too.
READ_NOISE = "detector.read_noise_e"


class Dark(NamedTuple):
    """Samples without laser light: their mean and variance, DN and DN², from slices with the laser off."""

    mean_dn: float
    variance_dn2: float


@dataclass(frozen=True, eq=False)
class Instrument:
    """The declared rig in numbers: lengths in m, times in s, counts in DN. Each is read when it is first used, so that an
    estimator works with a rig that states as unknown what it does not need; one that it needs raises InputError.

    `rig` is the declared rig itself, for values that few estimators need; `dark` holds the noise of slices with the laser
    off, which replaces a read noise that is unknown.
    """

    rig: DeclaredRig
    dark: Dark | None = None

    @cached_property
    def rows(self) -> int:
        """Rows of the array."""
        return self.rig.whole("camera.rows")

    @cached_property
    def cols(self) -> int:
        """Columns of the array."""
        return self.rig.whole("camera.cols")

    @cached_property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        rig = self.rig
        return rig.number("camera.focal_length_m", above=0) / rig.number("camera.pixel_pitch_m", above=0)

    @cached_property
    def principal_row(self) -> float:
        """Row of the optical axis."""
        return self.rig.number("camera.principal_row_px")

    @cached_property
    def principal_col(self) -> float:
        """Column of the optical axis."""
        return self.rig.number("camera.principal_col_px")

    @cached_property
    def group_index(self) -> float:
        """Group refractive index of the medium."""
        return self.rig.number("medium.group_index", above=0)

    @cached_property
    def laser_m(self) -> Float:
        """Position of the laser, x, y, z."""
        return self.rig.numbers("laser.position_m", length=3)

    @property
    def responses(self) -> tuple[Response, ...]:
        """R(u) of every gate."""
        return _responses(self.rig)

    @property
    def gate_area_s(self) -> tuple[float, ...]:
        """∫R du of every gate."""
        return tuple(response.area_s for response in self.responses)

    @cached_property
    def iris_s(self) -> float:
        """How much later the gate opens in the corners; 0 where the rig declares no map."""
        return 0.0 if self.rig.get("gate_offset_s") is None else self.rig.number("gate_offset_s.iris_s")

    @cached_property
    def skew_s(self) -> tuple[float, float]:
        """The same per half width along (x, y)."""
        if self.rig.get("gate_offset_s") is None:
            return 0.0, 0.0
        skew = self.rig.numbers("gate_offset_s.skew_s", length=2)
        return float(skew[0]), float(skew[1])

    @cached_property
    def tube(self) -> Amplifier:
        """The intensifier."""
        return self.rig.amplifier("detector.intensifier")

    @cached_property
    def converter(self) -> Converter:
        """The converter. Raises InputError where the read noise is unknown, and no slices show it."""
        if not self.rig.unknown(READ_NOISE):
            return self.rig.converter("detector")
        if self.dark is None:
            raise InputError(
                "The read noise is unknown (null), and too few slices with the laser off show it.",
                where=f"attribute rig: {READ_NOISE}", allowed="a number of electrons; or two laser-off slices or more",
                next_step="declare the read noise, or record slices with laser_on = False",
            )  # fmt: skip
        # Var = gain²(F² G² μ + σ_r²) + 1/12 with μ = (mean − offset)/(gain G).
        gain, tube = self.rig.number("detector.gain_dn_per_e", above=0), self.tube
        light = max(self.dark.mean_dn - self.offset_dn, 0.0) / (gain * tube.gain)
        square = (self.dark.variance_dn2 - 1 / 12) / gain**2 - tube.excess * tube.gain**2 * light
        return self.rig.converter("detector", read_noise_e=math.sqrt(max(square, 0.0)))

    @cached_property
    def offset_dn(self) -> float:
        """Count without light."""
        return self.rig.number("detector.offset_dn")

    @property
    def dn_per_pe(self) -> float:
        """DN per photoelectron, the gain of an intensifier included."""
        return self.converter.gain_dn_per_e * self.tube.gain

    @property
    def excess(self) -> float:
        """Excess noise factor F², 1 without an intensifier."""
        return self.tube.excess

    @property
    def floor_var(self) -> float:
        """Variance [photoelectrons²] that does not grow with light: read noise, step of the converter."""
        return self.converter.floor_e2 / self.tube.gain**2

    @property
    def saturation_dn(self) -> float:
        """Count from which a sample is taken as clipped."""
        return self.converter.saturation_dn

    @property
    def dead_dn(self) -> float:
        """Count at and below which a sample is no datum; −inf where the offset is low."""
        return self.converter.dead_dn

    @cached_property
    def pulses_per_slice(self) -> float:
        """Pulses of a nominal slice."""
        return self.rig.number("pulses_per_slice", above=0)

    @property
    def key(self) -> str:
        """Short text that is equal for equal instruments."""
        return self.rig.key if self.dark is None else f"{self.rig.key} {self.dark}"

    @property
    def m_per_s(self) -> float:
        """Range per unit delay of a coaxial rig, c/(2 n_g)."""
        return C_M_PER_S / (2 * self.group_index)

    def rays(self) -> Float:
        """Unit vectors through the pixel centres, (row, col, xyz)."""
        x = (np.arange(self.cols) - self.principal_col) / self.focal_px
        y = (np.arange(self.rows) - self.principal_row) / self.focal_px
        ray = np.empty((self.rows, self.cols, 3))
        ray[..., 0], ray[..., 1], ray[..., 2] = x[None, :], y[:, None], 1.0
        ray /= np.sqrt((ray**2).sum(axis=-1, keepdims=True))
        return ray

    def gate_offset(self) -> Float | None:
        """How much later the gate opens at each pixel [s], (row, col): iris·ρ² + skew·(x/half width, y/half height).

        ρ is the distance from the centre of the array, over that of a corner. None where the rig declares no map.
        """
        if self.iris_s == 0.0 and self.skew_s == (0.0, 0.0):
            return None
        return gate_offset_map(self.rows, self.cols, self.iris_s, self.skew_s)

    def to_range(self, tau_s: Float, sigma_s: Float) -> tuple[Float, Float]:
        """Radial range [m] of an echo at tau_s along the ray of its pixel, and its standard error, (row, col) each.

        The gate offsets are added here. With path D = c·τ/n_g and laser position L, |p| + |p−L| = D along the unit ray d
        gives r = (D² − |L|²)/(2(D − d·L)), which is D/2 for L = 0.
        """
        offset = self.gate_offset()
        tau = tau_s if offset is None else tau_s + offset
        path = 2 * self.m_per_s * tau
        if not self.laser_m.any():
            return 0.5 * path, sigma_s * self.m_per_s
        along = self.rays() @ self.laser_m
        square = float(self.laser_m @ self.laser_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            gap = path - along
            r = (path**2 - square) / (2 * gap)
            slope = (2 * path * gap - (path**2 - square)) / (2 * gap**2)
            r = np.where(path > np.sqrt(square), r, np.nan)
        return r, sigma_s * 2 * self.m_per_s * np.abs(slope)


@lru_cache(maxsize=16)
def _responses(rig: DeclaredRig) -> tuple[Response, ...]:
    pulse, jitter = rig.samples("pulse"), rig.number("laser.jitter_shot_s", least=0)
    gates = range(len(rig.need("gates")))
    return tuple(correlate_samples(pulse, rig.samples(f"gates.{i}"), jitter_s=jitter) for i in gates)


@lru_cache(maxsize=16)
def _instrument(rig: DeclaredRig, dark: Dark | None) -> Instrument:
    return Instrument(rig, dark)


def instrument_of(capture: xr.Dataset, dark: Dark | None = None) -> Instrument:
    """The instrument declared by a gated capture. dark: of its slices with the laser off; used where the read noise is unknown.

    Raises InputError where the rig is missing, or lacks values, all of which it names.
    """
    rig = read_rig(capture, "gated")
    check_keys(rig, GATED_KEYS)
    return _instrument(rig, dark if rig.unknown(READ_NOISE) else None)
