"""What the gated estimators need of the declared rig, worked out once per rig."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import xarray as xr

from ....optics.constants import C_M_PER_S
from ....optics.correlation.gate_maps import gate_offset_map
from ....scenes.errors import InputError
from ...response import Response, correlate_samples
from ...rig import DeclaredRig, read_rig

__all__ = ["Instrument", "instrument_of"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Instrument:
    """The declared rig in numbers: lengths in m, times in s, counts in DN.

    `rig` is the declared rig itself, for values that few estimators need. `dn_per_pe` is DN per photoelectron (gain of an
    intensifier included), `excess` the excess noise factor F² (1 without an intensifier), `floor_var` the variance in
    photoelectrons² that does not grow with light (read noise, ADC step), `saturation_dn` the count from which a sample is
    taken as clipped, `dead_dn` the count at and below which it is no datum (−inf where the offset is low).
    """

    rig: DeclaredRig
    rows: int
    cols: int
    focal_px: float
    principal_row: float
    principal_col: float
    group_index: float
    laser_m: Float
    responses: tuple[Response, ...]
    gate_area_s: tuple[float, ...]
    iris_s: float
    skew_s: tuple[float, float]
    offset_dn: float
    dn_per_pe: float
    excess: float
    floor_var: float
    saturation_dn: float
    dead_dn: float
    pulses_per_slice: float

    @property
    def key(self) -> str:
        """Short hash of the declared rig."""
        return self.rig.key

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
def _instrument(rig: DeclaredRig) -> Instrument:
    pulse, gates = rig.samples("pulse"), rig.need("gates")
    if not isinstance(gates, list) or not gates:
        raise InputError(
            "The declared rig has no gate.", where="attribute rig: gates", value=gates,
            allowed="a list of one gate or more, each as samples",
        )  # fmt: skip
    jitter = rig.number("laser.jitter_shot_s", least=0)
    responses = tuple(correlate_samples(pulse, rig.samples(f"gates.{i}"), jitter_s=jitter) for i in range(len(gates)))
    converter, tube = rig.converter("detector"), rig.amplifier("detector.intensifier")
    iris, skew = 0.0, np.zeros(2)
    if rig.get("gate_offset_s") is not None:
        iris, skew = rig.number("gate_offset_s.iris_s"), rig.numbers("gate_offset_s.skew_s", length=2)
    return Instrument(
        rig=rig,
        rows=rig.whole("camera.rows"),
        cols=rig.whole("camera.cols"),
        focal_px=rig.number("camera.focal_length_m", above=0) / rig.number("camera.pixel_pitch_m", above=0),
        principal_row=rig.number("camera.principal_row_px"),
        principal_col=rig.number("camera.principal_col_px"),
        group_index=rig.number("medium.group_index", above=0),
        laser_m=rig.numbers("laser.position_m", length=3),
        responses=responses,
        gate_area_s=tuple(r.area_s for r in responses),
        iris_s=iris,
        skew_s=(float(skew[0]), float(skew[1])),
        offset_dn=converter.offset_dn,
        dn_per_pe=converter.gain_dn_per_e * tube.gain,
        excess=tube.excess,
        floor_var=converter.floor_e2 / tube.gain**2,
        saturation_dn=converter.saturation_dn,
        dead_dn=converter.dead_dn,
        pulses_per_slice=rig.number("pulses_per_slice", above=0),
    )


def instrument_of(capture: xr.Dataset) -> Instrument:
    """The instrument declared by a gated capture. Raises InputError where the rig is missing or cannot be used."""
    return _instrument(read_rig(capture, "gated"))
