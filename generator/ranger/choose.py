"""The choice between rungs for one-detector rangers (waveform, amcw): sizes of what `direct` leaves out, by closed forms.

The receiver sees a narrow cone: what its own field gathers of the halo, what the water sends back, and light between surfaces.
Each is relative to the echo of the target at the axis' range; they add, as an upper bound.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...optics.constants import C_M_PER_S
from ...optics.water.beam import beam_halo
from ...optics.water.halo import halo_spread
from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...optics.water.phase_function import asymmetry
from ...scenes.errors import InputError
from ...scenes.medium_index import group_index
from ...scenes.rigs.amcw import amcw_rig
from ...scenes.rigs.waveform import waveform_rig
from ...scenes.scene import Scene
from ..gated.choose import RUNG_SHARE, Choice, Rtol
from ..gated.effects import interreflection
from ..water.ramp import beam_edge, beam_profile
from .amcw import expected_samples
from .footprint import ranger_footprint
from .waveform import expected_waveform

__all__ = ["choose_ranger", "ranger_sizes"]

#: Rungs that these modalities have, from the cheapest.
_RUNGS: tuple[Literal["direct", "scatter"], ...] = ("direct", "scatter")
#: Effects that the scatter rung models.
_SCATTERED = ("forward-scattered light", "volume backscatter")
_RAYS = 256
#: Nearest water that counts, in diameters of the aperture: nearer than that lamp and lens see different water.
_NEAREST_APERTURES = 2.0


def choose_ranger(scene: Scene, rtol: Rtol) -> Choice:
    """ "direct" where all it leaves out is predicted to stay below `rtol`, else "scatter" where that does.

    Raises:
        InputError: both leave out more than that, and no other rung is built for the modality.
    """
    sizes = ranger_sizes(scene)
    limit = _relative_noise(scene) if rtol == "noise" else float(rtol)
    missing = {"direct": {n: s for n, s in sizes.items() if n != "multiple scattering"}}
    if scene.medium.scattering_per_m > 0:
        missing["scatter"] = {n: s for n, s in sizes.items() if n not in _SCATTERED}
    error = {rung: float(sum(left.values())) for rung, left in missing.items()}
    passing: list[Literal["direct", "scatter"]] = [rung for rung in _RUNGS if error.get(rung, np.inf) <= limit]
    if not passing:
        best = "scatter" if "scatter" in missing else "direct"
        left = missing[best]
        worst = max(left, key=lambda name: left[name])
        raise InputError(
            f"The upper rung of this modality, {best}, leaves out light that changes the echo by up to "
            f"{error[best]:.2g} ({worst}: {left[worst]:.2g}), more than the limit of {limit:.2g}.",
            where=f"{scene.name}: fidelity", value="auto", allowed=", ".join(_RUNGS),
            next_step='raise rtol, or ask for fidelity="direct" knowing this',
        )  # fmt: skip
    rung = passing[0]
    share = RUNG_SHARE[rung] * limit / 0.5
    return Choice(rung, min(max(share, 1e-6), 0.5), error, limit, "closed forms", sizes, limit)


def ranger_sizes(scene: Scene) -> dict[str, float]:
    """Predicted size of each effect that `direct` leaves out, relative to the echo, by its name in the catalogue."""
    bounce, _ = interreflection(scene)
    brightest = max(item.material.albedo_at_normal() for item in scene.target)
    sizes = {"interreflection": brightest if bounce is None else bounce}
    medium = scene.medium
    if medium.scattering_per_m == 0:
        return sizes
    if medium.phase is None:
        raise InputError(
            "Predicting scattered light needs the medium's phase function.",
            where=f"{scene.name}: medium.phase_function", next_step="give one, or use fidelity=\"direct\"",
        )  # fmt: skip
    distance = _axis_range(scene)
    return sizes | {
        "forward-scattered light": _forward(scene, medium.phase, distance),
        "volume backscatter": _backscatter(scene, medium.phase, distance),
        "multiple scattering": float(
            -np.expm1(-2.0 * medium.scattering_per_m * (1.0 - asymmetry(medium.phase)) * distance)
        ),
    }


def _axis_range(scene: Scene) -> float:
    beam = ranger_footprint(scene, _RAYS)
    seen = beam.axis_range[np.isfinite(beam.axis_range)]
    if not seen.size:
        raise InputError(
            "No shot's axis meets the target, so no error can be predicted.", where=f"{scene.name}: target",
            next_step='use fidelity="direct"',
        )  # fmt: skip
    return float(np.median(seen))


def _forward(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """(1 + X(0)/I(0))(1 + h within the field) − 1: halo of the beam on its axis, and of the way back within the field."""
    rig = waveform_rig(scene) if scene.modality == "waveform" else amcw_rig(scene)
    spec, length = rig.laser.illumination, scene.medium.scattering_per_m * range_m
    edge = beam_edge(spec)
    out = float(beam_halo(np.zeros(1), lambda t: beam_profile(spec, t), edge, phase, length)[0])
    peak = float(beam_profile(spec, np.zeros(1))[0])
    field = float(np.arctan2(0.5 * rig.detector.active_diameter_m, rig.receiver.focal_length_m))
    back = float(halo_spread(phase, length).enclosed_within(field))
    return (1.0 + (out / peak if peak > 0 else 0.0)) * (1.0 + back) - 1.0


def _backscatter(scene: Scene, phase: PhaseFunction, range_m: float) -> float:
    """Water over target. Waveform: the brightest moment of the record against the echo's peak, b β̃(π) w e^{2c(r − r₀)}
    (r/r₀)²/(ρ/π), w = ½ c/n_g √(2π)σ of the pulse, r₀ where the record begins; amcw: all water against the target's light."""
    medium = scene.medium
    turned = medium.scattering_per_m * float(phase_density(phase, np.pi))
    matt = max(item.material.albedo_at_normal() for item in scene.target) / np.pi
    c = medium.attenuation_per_m
    rig = waveform_rig(scene) if scene.modality == "waveform" else amcw_rig(scene)
    nearest = _NEAREST_APERTURES * rig.receiver.aperture_diameter_m
    half_speed = 0.5 * C_M_PER_S / group_index(medium, rig.laser.wavelength_m)
    if scene.modality == "waveform":
        from ...optics.correlation.waveforms import pulse_variance
        from ...scenes.rigs.waveform import shown_pulse

        record = waveform_rig(scene).record
        width = half_speed * float(np.sqrt(2.0 * np.pi * pulse_variance(shown_pulse(waveform_rig(scene))[0])))
        first = min(max(record.start_s * half_speed, nearest), range_m)
        return float(turned * width / matt * np.exp(2.0 * c * (range_m - first)) * (range_m / first) ** 2)
    r = np.geomspace(min(nearest, range_m), range_m, 512)
    dense = turned * np.exp(2.0 * c * (range_m - r)) * (range_m / r) ** 2 / matt
    return float(np.trapezoid(dense, r))


def _relative_noise(scene: Scene) -> float:
    """rms of the noise of a sample over the rms of the signal's samples, within 1e-4 … 0.5."""
    if scene.modality == "waveform":
        signal, ambient = expected_waveform(scene, ranger_footprint(scene, _RAYS), 0, 0)
        readout = waveform_rig(scene).detector.readout
        read = float(getattr(readout, "read_noise_e", 0.0))
    else:
        wave, ambient = expected_samples(scene, ranger_footprint(scene, _RAYS), 0, 0)
        signal = wave.astype(np.float32)
        read = amcw_rig(scene).detector.read_noise_e
    mean_square = float(np.mean(signal.astype(np.float64) ** 2))
    variance = float(np.mean(signal)) + ambient + read**2
    return float(np.clip(np.sqrt(variance / mean_square), 1e-4, 0.5)) if mean_square > 0 else 0.5
