"""The choice between the rungs of one-detector rangers: sizes of what `direct` leaves out, by closed forms.

The receiver sees a narrow cone: what its own field gathers of the halo, what the water sends back, and light between surfaces.
Each is relative to the echo of the target at the axis' range; they add, as an upper bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...optics.water.beam import beam_halo
from ...optics.water.halo import halo_spread
from ...optics.water.phase_forms import PhaseFunction, phase_density
from ...optics.water.phase_function import asymmetry
from ...scenes.errors import InputError
from ...scenes.scene import Scene
from ..choice import Choice, Rtol, Rung, chosen
from ..effect import interreflection
from ..water.phase import phase_of
from .footprint import Footprint, Ranger, ranger_footprint

__all__ = ["Instrument", "Stack", "choose_ranger", "nearest_water_m", "ranger_sizes", "turned_back_and_matt"]

Stack = NDArray[np.float32]

#: Rungs that these modalities have, from the cheapest.
_RUNGS: tuple[Rung, ...] = ("direct", "scatter")
#: Effects that the scatter rung models.
_SCATTERED = ("forward-scattered light", "volume backscatter")
_RAYS = 256
#: Nearest water that counts, in diameters of the aperture: nearer than that lamp and lens see different water.
_NEAREST_APERTURES = 2.0


@dataclass(frozen=True)
class Instrument:
    """What the choice needs to know of one kind of ranger.

    Main arguments:
        ranger: beam, lens and shots.
        backscatter: (phase function, range of the target in m) -> light of the water relative to the echo.
        samples: footprint -> expected photoelectrons of the echoes, those of ambient light and dark in a sample, and the
            read noise in electrons.
    """

    ranger: Ranger
    backscatter: Callable[[PhaseFunction, float], float]
    samples: Callable[[Footprint], tuple[Stack, float, float]]


def choose_ranger(scene: Scene, rtol: Rtol, instrument: Instrument) -> Choice:
    """ "direct" where all it leaves out is predicted to stay below `rtol`, else "scatter" where that does.

    Raises:
        InputError: both leave out more than that, and no other rung is built for the modality.
    """
    sizes = ranger_sizes(scene, instrument)
    limit = _relative_noise(scene, instrument) if rtol == "noise" else float(rtol)
    missing = {"direct": {n: s for n, s in sizes.items() if n != "multiple scattering"}}
    if scene.medium.scattering_per_m > 0:
        missing["scatter"] = {n: s for n, s in sizes.items() if n not in _SCATTERED}
    error = {rung: float(sum(left.values())) for rung, left in missing.items()}
    passing = [rung for rung in _RUNGS if error.get(rung, np.inf) <= limit]
    if not passing:
        best = "scatter" if "scatter" in missing else "direct"
        left = missing[best]
        worst = max(left, key=lambda name: left[name])
        raise InputError(
            f"The upper rung of this modality, {best}, leaves out light that changes the echo by up to "
            f"{error[best]:.2g} ({worst}: {left[worst]:.2g}), more than the limit of {limit:.2g}.",
            where=f"{scene.name}: fidelity", value="auto", allowed=", ".join(_RUNGS),
            next_step='raise rtol, or give fidelity="direct" knowing this',
        )  # fmt: skip
    # The catalogue of effects has better sizes than these upper bounds.
    return chosen(passing[0], error, limit, limit, "closed forms", sizes, supersedes=False)


def ranger_sizes(scene: Scene, instrument: Instrument) -> dict[str, float]:
    """Predicted size of each effect that `direct` leaves out, relative to the echo, by its name in the catalogue.

    Raises:
        InputError: no shot's axis meets the target; the medium scatters and has no phase function.
    """
    bounce, _ = interreflection(scene)
    brightest = max(item.material.albedo_at_normal() for item in scene.target)
    sizes = {"interreflection": brightest if bounce is None else bounce}
    phase = phase_of(scene)
    if phase is None:
        return sizes
    distance = _axis_range(scene, instrument.ranger)
    multiple = -np.expm1(-2.0 * scene.medium.scattering_per_m * (1.0 - asymmetry(phase)) * distance)
    return sizes | {
        "forward-scattered light": _forward(scene, instrument.ranger, phase, distance),
        "volume backscatter": instrument.backscatter(phase, distance),
        "multiple scattering": float(multiple),
    }


def turned_back_and_matt(scene: Scene, phase: PhaseFunction) -> tuple[float, float]:
    """(b β̃(π), share of the light that the water sends straight back [1/(m sr)]; ρ/π of the brightest surface [1/sr])."""
    turned = scene.medium.scattering_per_m * float(phase_density(phase, np.pi))
    return turned, max(item.material.albedo_at_normal() for item in scene.target) / np.pi


def nearest_water_m(ranger: Ranger) -> float:
    """Range of the nearest water that counts, m."""
    return _NEAREST_APERTURES * ranger.receiver.aperture_diameter_m


def _axis_range(scene: Scene, ranger: Ranger) -> float:
    beam = ranger_footprint(scene, ranger, _RAYS)
    seen = beam.axis_range[np.isfinite(beam.axis_range)]
    if not seen.size:
        raise InputError(
            "No shot's axis meets the target, so no error can be predicted.", where=f"{scene.name}: target",
            next_step='use fidelity="direct"',
        )  # fmt: skip
    return float(np.median(seen))


def _forward(scene: Scene, ranger: Ranger, phase: PhaseFunction, range_m: float) -> float:
    """(1 + X(0)/I(0))(1 + h within the field) − 1: halo of the beam on its axis, and of the way back within the field."""
    lamp, length = ranger.lamp, scene.medium.scattering_per_m * range_m
    out = float(beam_halo(np.zeros(1), lamp.profile, lamp.edge_rad, phase, length)[0])
    peak = float(lamp.profile(np.zeros(1))[0])
    back = float(halo_spread(phase, length).enclosed_within(ranger.field_rad))
    return (1.0 + (out / peak if peak > 0 else 0.0)) * (1.0 + back) - 1.0


def _relative_noise(scene: Scene, instrument: Instrument) -> float:
    """rms of the noise of a sample over the rms of the signal's samples, within 1e-4 … 0.5."""
    signal, ambient, read = instrument.samples(ranger_footprint(scene, instrument.ranger, _RAYS))
    mean_square = float(np.mean(signal.astype(np.float64) ** 2))
    variance = float(np.mean(signal)) + ambient + read**2
    return float(np.clip(np.sqrt(variance / mean_square), 1e-4, 0.5)) if mean_square > 0 else 0.5
