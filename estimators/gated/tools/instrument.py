"""The instrument as declared: the `rig` attribute of a capture, parsed once and kept by its hash."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ....optics.constants import C_M_PER_S
from ....optics.correlation.gate_maps import gate_offset_map
from ....scenes.errors import InputError
from ...response import Response, correlate_samples

__all__ = ["Instrument", "instrument_of"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Instrument:
    """What estimators need of the declared rig. Lengths in m, times in s, counts in DN.

    `dn_per_pe` is DN per photoelectron (intensifier gain included), `excess` the excess noise factor F² (1 without an
    intensifier), `floor_var` the variance in photoelectrons² that does not grow with light (read noise, ADC step),
    `saturation_dn` the count from which a sample is taken as clipped.
    """

    key: str
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
    pulses_per_slice: float
    rig: dict[str, Any]

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
        """Later opening of the gate per pixel [s], (row, col): iris·ρ² + skew·(x/half width, y/half height).

        ρ is the radius over the corner's radius, from the array's centre. None where the rig declares no map.
        """
        if self.iris_s == 0.0 and self.skew_s == (0.0, 0.0):
            return None
        return gate_offset_map(self.rows, self.cols, self.iris_s, self.skew_s)

    def to_range(self, tau_s: Float, sigma_s: Float) -> tuple[Float, Float]:
        """Radial range [m] along each pixel's ray of an echo at tau_s, and its standard error, (row, col) each.

        Gate offsets are added here. With path D = c·τ/n_g and laser position L, |p| + |p−L| = D along the unit ray d
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


def _need(rig: dict[str, Any], path: str) -> Any:
    node: Any = rig
    for part in path.split("."):
        if not isinstance(node, dict) or part not in node:
            raise InputError("the declared rig lacks a value", where=f"attribute rig: {path}", allowed="schema 1")
        node = node[part]
    return node


@lru_cache(maxsize=16)
def _parse(text: str) -> Instrument:
    try:
        rig = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError("the declared rig is not JSON", where="attribute rig", value=text[:80]) from error
    if not isinstance(rig, dict) or rig.get("schema") != 1 or rig.get("kind") != "gated":
        raise InputError("not the declared rig of a gated capture", where="attribute rig", allowed="schema 1, gated")
    pulse, gates = _need(rig, "pulse"), _need(rig, "gates")
    if not gates:
        raise InputError("the declared rig has no gate", where="attribute rig: gates")
    jitter = float(_need(rig, "laser.jitter_shot_s"))
    responses = tuple(correlate_samples(pulse, gate, jitter_s=jitter) for gate in gates)
    detector = _need(rig, "detector")
    intensifier = detector.get("intensifier")
    gain = float(_need(rig, "detector.gain_dn_per_e"))
    read = float(_need(rig, "detector.read_noise_e"))
    offset = float(_need(rig, "detector.offset_dn"))
    boost = float(intensifier["gain"]) if intensifier else 1.0
    full = offset + gain * (float(_need(rig, "detector.full_well_e")) - 4 * read)
    gate_map = rig.get("gate_offset_s") or {"iris_s": 0.0, "skew_s": (0.0, 0.0)}
    return Instrument(
        key=hashlib.sha256(text.encode()).hexdigest()[:16],
        rows=int(_need(rig, "camera.rows")),
        cols=int(_need(rig, "camera.cols")),
        focal_px=float(_need(rig, "camera.focal_length_m")) / float(_need(rig, "camera.pixel_pitch_m")),
        principal_row=float(_need(rig, "camera.principal_row_px")),
        principal_col=float(_need(rig, "camera.principal_col_px")),
        group_index=float(_need(rig, "medium.group_index")),
        laser_m=np.asarray(_need(rig, "laser.position_m"), dtype=np.float64),
        responses=responses,
        gate_area_s=tuple(r.area_s for r in responses),
        iris_s=float(gate_map["iris_s"]),
        skew_s=(float(gate_map["skew_s"][0]), float(gate_map["skew_s"][1])),
        offset_dn=offset,
        dn_per_pe=gain * boost,
        excess=float(intensifier["excess_noise_factor"]) if intensifier else 1.0,
        floor_var=(read**2 + 1 / (12 * gain**2)) / boost**2,
        saturation_dn=min(2.0 ** int(_need(rig, "detector.adc_bits")) - 1, full),
        pulses_per_slice=float(_need(rig, "pulses_per_slice")),
        rig=rig,
    )


def instrument_of(capture: xr.Dataset) -> Instrument:
    """The instrument declared by a gated capture. Raises InputError where the rig is missing or unusable."""
    text = capture.attrs.get("rig")
    if not isinstance(text, str):
        raise InputError("the capture declares no rig", where="attribute rig", allowed="a JSON string")
    return _parse(text)
