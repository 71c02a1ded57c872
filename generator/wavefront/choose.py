"""The choice of the rung by its predicted error: a small array of the scene's optics, rendered at every rung."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...scenes.errors import InputError
from ...scenes.medium_index import phase_index
from ...scenes.rigs.wavefront import WavefrontRig, wavefront_rig
from ...scenes.rigs.wavefront_geometry import lattice_of, spot_px
from ...scenes.scene import Scene
from ..choice import Choice, Rung, chosen
from ..noise import noise_variance
from ..request import Request
from .field import Pupils
from .fields import pilot
from .light import reflectors
from .possible import MOST_ROTATION_DEG
from .speckle import Speckle
from .spots import spot_image

__all__ = ["choose", "predicted"]

#: Lenslets of a side of the pilot, and the draws of turbulence of which the worse one counts.
_ACROSS, _DRAWS = 6, (0, 1, 2)
_RUNGS: tuple[Rung, ...] = ("geometric", "isolated", "coherent")


def choose(scene: Scene, request: Request) -> Choice:
    """The cheapest rung whose image differs from that of `coherent` by less than `rtol` of its root mean square; with "noise", by
    less than the noise of a spot's brightest pixel.

    The difference is that of the pilot: blur within lenslets, and interference between them. Scintillation is left out of it.

    Raises:
        InputError: an array turned against its pixels by more than 2°, whose fields no rung models.
    """
    rig = wavefront_rig(scene)
    if abs(rig.lenslets.rotation_deg) > MOST_ROTATION_DEG:
        raise InputError(
            "No rung can be compared with one that adds fields: the array is turned against its pixels.",
            where=f"{scene.name}: rig.lenslets.rotation_deg", value=rig.lenslets.rotation_deg,
            allowed=f"-{MOST_ROTATION_DEG:g} to {MOST_ROTATION_DEG:g}", next_step='give fidelity="geometric"',
        )  # fmt: skip
    error = predicted(scene)
    limit = _noise(scene) if request.rtol == "noise" else float(request.rtol)
    rung = next(rung for rung in _RUNGS if error[rung] <= limit)
    shown: dict[str, float] = {str(name): value for name, value in error.items()}
    basis = f"{_ACROSS} × {_ACROSS} lenslets of the scene's optics, the worst of {len(_DRAWS)} draws"
    return chosen(rung, shown, limit, max(limit, 1e-6), basis, {}, supersedes=False)


def predicted(scene: Scene) -> dict[Rung, float]:
    """Error of each rung's spots, rms over rms of those of `coherent`, of the pilot. The flat wave counts as a draw."""
    ranges = [one.range_m for one in reflectors(scene)]
    return dict(
        zip(
            _RUNGS,
            _predicted(_small(wavefront_rig(scene)).model_dump_json(), max(ranges, default=1.0), _in_water_m(scene)),
            strict=True,
        )
    )


def _in_water_m(scene: Scene) -> float:
    rig = wavefront_rig(scene)
    return rig.wavelength_m / phase_index(scene.medium, rig.wavelength_m)


def _small(rig: WavefrontRig) -> WavefrontRig:
    """A few lenslets of the rig; with an aberration, whose curvature depends on the place, all of them, in one frame."""
    if rig.aberration is None:
        return pilot(rig, _ACROSS)
    return rig.model_copy(update={"frames": rig.frames.model_copy(update={"count": 1})})


@lru_cache(maxsize=16)
def _predicted(rig_json: str, range_m: float, in_water_m: float) -> tuple[float, float, float]:
    rig = WavefrontRig.model_validate_json(rig_json)
    lit = lattice_of(rig, every=True)
    worst = np.zeros(3)
    for seed in _DRAWS:
        pupils = Pupils(rig, lattice_of(rig), seed, 0)
        # One pattern of speckle, if any: the sum of several errs by less.
        _, part = next(Speckle(rig, pupils.size, pupils.step_m, in_water_m, seed, 0).parts(0, range_m))
        field = np.asarray(np.exp(1j * pupils.phase(0, range_m)) * part)
        images = [spot_image(rig, lit, field, 1.0, rung) for rung in _RUNGS]
        whole = float(np.sqrt((images[2] ** 2).sum()))
        worst = np.maximum(worst, [float(np.sqrt(((image - images[2]) ** 2).sum())) / whole for image in images])
    return float(worst[0]), float(worst[1]), float(worst[2])


def _noise(scene: Scene) -> float:
    """Standard deviation of a spot's brightest pixel over its light, within 1e-4 … 0.5."""
    rig = wavefront_rig(scene)
    peak = max((one.electrons for one in reflectors(scene)), default=0.0) * min(1.0, spot_px(rig) ** -2)
    if peak <= 0:
        return 0.5
    return float(np.clip(np.sqrt(float(noise_variance(rig.detector, peak))) / peak, 1e-4, 0.5))
