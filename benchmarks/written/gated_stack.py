"""Gated stacks of a Gaussian response, from its closed form: the declared rig, expected counts and the exact bound.

Pulse and gate are Gaussian, so R(u) = a·exp(−(u−u₀)²/2σ_R²) with σ_R² = σ_p² + σ_g². The counts follow this closed form;
the declared rig holds samples of pulse and gate, so an estimator that misreads the samples gives wrong ranges here. This
file imports no scene and no renderer: a child process that measures memory can import it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from ...captures.build import make_capture
from ...optics.constants import C_M_PER_S

__all__ = ["GaussianRig", "poisson_bound", "stack_capture"]

Float = npt.NDArray[np.float64]


@dataclass(frozen=True)
class GaussianRig:
    """A rig whose response is Gaussian. Times in s; `sigma_s` is σ_R, split evenly between pulse and gate."""

    sigma_s: float = 0.6e-9
    slices: int = 64
    start_s: float = 30e-9
    step_s: float = 0.25e-9
    offset_dn: float = 0.0
    gain_dn_per_e: float = 1.0
    read_noise_e: float = 0.0
    group_index: float = 1.0
    laser_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    intensifier: tuple[float, float] | None = None

    @property
    def part_s(self) -> float:
        """σ of the pulse, equal to that of the gate."""
        return float(self.sigma_s / np.sqrt(2))

    @property
    def centre_s(self) -> float:
        """u₀: the argument at which R is greatest (the middle of the gate is half a width after its opening edge)."""
        return float(self.part_s * np.sqrt(2 * np.log(2)))

    @property
    def delay_s(self) -> Float:
        """Delays of the slices."""
        return np.asarray(self.start_s + self.step_s * np.arange(self.slices), dtype=np.float64)

    def response(self, u_s: Float) -> Float:
        """R(u) for a gate with transmission 1 at its middle."""
        return np.asarray(np.exp(-0.5 * ((u_s - self.centre_s) / self.sigma_s) ** 2) * self.part_s / self.sigma_s)

    def declared(self, rows: int, cols: int) -> dict[str, Any]:
        """The declared rig, pulse and gate as samples of step σ/40 over ±7 σ."""
        t = np.arange(-280, 281) / 40
        density = np.exp(-0.5 * t**2)
        step = self.part_s / 40
        boost = self.intensifier
        return {
            "schema": 1, "kind": "gated", "name": "gaussian",
            "camera": {
                "rows": rows, "cols": cols, "pixel_pitch_m": 10e-6, "focal_length_m": 10e-3,
                "principal_row_px": (rows - 1) / 2, "principal_col_px": (cols - 1) / 2, "f_number": 2.0,
                "transmission": 0.9, "quantum_efficiency": 0.5, "vignetting": "none",
            },
            "laser": {
                "wavelength_m": 532e-9, "pulse_energy_j": 1e-6, "half_angle_rad": 0.2, "profile": "flat-top",
                "offset_rad": [0.0, 0.0], "position_m": list(self.laser_m), "energy_fluctuation": 0.0,
                "jitter_shot_s": 0.0, "jitter_frame_s": 0.0,
            },
            "pulse": {"start_s": -7 * self.part_s, "step_s": step, "value": list(density / density.sum() / step)},
            "gates": [{"start_s": self.centre_s - 7 * self.part_s, "step_s": step, "value": list(density)}],
            "gate_offset_s": None,
            "medium": {"phase_index": 1.0, "group_index": self.group_index, "absorption_per_m": 0.0,
                       "scattering_per_m": 0.0},
            "detector": {
                "dark_current_e_per_s": 0.0, "exposure_s": 1e-3, "read_noise_e": self.read_noise_e, "prnu": 0.0,
                "dsnu_e": 0.0, "gain_dn_per_e": self.gain_dn_per_e, "offset_dn": self.offset_dn,
                "full_well_e": 1e6, "adc_bits": 16,
                "intensifier": None if boost is None else {
                    "gain": boost[0], "excess_noise_factor": boost[1], "phosphor_sigma_px": 0.0},
            },
            "ambient_e_per_s": 0.0, "pulses_per_slice": 1, "t0_s": 0.0,
        }  # fmt: skip

    def electrons(self, tau_s: Float, signal_e: float | Float, background_e: float | Float) -> Float:
        """Expected photoelectrons (slice, …) of echoes at tau_s; `signal_e` is their sum over an infinite
        grid of delays, `background_e` the level per slice."""
        r = self.response(tau_s[None] - self.delay_s.reshape(-1, *([1] * np.ndim(tau_s))))
        amplitude = signal_e / (np.sqrt(2 * np.pi) * self.part_s / self.step_s)
        return np.asarray(amplitude * r + background_e)


def stack_capture(rig: GaussianRig, counts: npt.NDArray[Any], rig_json: dict[str, Any] | None = None) -> xr.Dataset:
    """A gated capture without truth, as of a recording, of counts (slice, row, col); float32 counts are marked as averaged."""
    declared = rig_json or rig.declared(*counts.shape[1:])
    coords = {
        "delay": rig.delay_s, "gate": 0, "pulses": 1, "laser_on": True,
        "time": np.arange(rig.slices, dtype=np.float64), "valid": True,
    }  # fmt: skip
    attrs: dict[str, Any] = {"rig": json.dumps(declared), "truth_kind": "none"}
    if counts.dtype == np.float32:
        attrs["averaged"] = True
    return make_capture("gated", {"counts": counts}, coords, {}, attrs)


def poisson_bound(rig: GaussianRig, tau_s: Float, signal_e: float | Float, background_e: float | Float) -> Float:
    """Cramér-Rao bound on range [m] for pure Poisson counts, amplitude and background as nuisances, in the shape of tau_s.

    J = Σ_k ∂μ_k ∂μ_kᵀ/μ_k over (τ, A, B) is the exact information of Poisson counts; the bound is √(J⁻¹)_ττ·c/2n_g.
    """
    u = tau_s[None] - rig.delay_s.reshape(-1, *([1] * np.ndim(tau_s))) - rig.centre_s
    mu = np.maximum(rig.electrons(tau_s, signal_e, background_e), 1e-300)
    r = rig.electrons(tau_s, 1.0, 0.0)
    slope = -u / rig.sigma_s**2 * (mu - background_e)
    columns = [slope, r, np.ones_like(r)]
    j = np.array([[(a * b / mu).sum(axis=0) for b in columns] for a in columns])
    j = np.moveaxis(j, (0, 1), (-2, -1))
    # Scaled to a unit diagonal before the inverse: the three parameters differ by many orders.
    d = np.sqrt(np.diagonal(j, axis1=-2, axis2=-1))
    inverse = np.linalg.inv(j / (d[..., :, None] * d[..., None, :]))
    return np.asarray(np.sqrt(inverse[..., 0, 0]) / d[..., 0] * C_M_PER_S / (2 * rig.group_index))
