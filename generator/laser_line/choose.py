"""The choice of the rung: the cheapest that leaves out less than the limit, or a refusal that says what it leaves out."""

from __future__ import annotations

import numpy as np

from ...scenes.errors import InputError
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import ambient_e_per_s
from ...scenes.scene import Scene
from ..choice import Choice, Rtol, Rung, chosen
from ..effect import interreflection
from .effects import EVEN_SCATTERED, MOTION, SCATTERED, motion_blur, scattered_sizes
from .expected import frame_light
from .setting import poses_of, setting_of

__all__ = ["choose"]

#: Relative error of the image that sizes are taken from.
_PILOT = 0.05


def choose(scene: Scene, rtol: Rtol) -> Choice:
    """ "direct" where scattered light, light between surfaces and motion blur, which it leaves out, are predicted to stay below
    `rtol` of the line's light, else "scatter". Speckle, and light reflected inside the port, have no prediction.

    Raises:
        InputError: both leave out more, or by an unknown amount; no other rung is built.
    """
    setting = setting_of(scene)
    light = frame_light(setting, poses_of(setting.rig)[0][0], _PILOT, wide=False)
    sizes = {name: size for name, (size, _) in scattered_sizes(scene, light).items()}
    sizes["interreflection"] = interreflection(scene)[0]
    sizes[MOTION] = motion_blur(scene, light)
    uneven = setting.rig.even_light_e_per_s and scene.medium.scattering_per_m > 0
    sizes[EVEN_SCATTERED] = None if uneven else 0.0
    limit = _noise(scene, float(light.line.max(initial=0.0))) if rtol == "noise" else float(rtol)
    left: dict[Rung, list[str]] = {"direct": [name for name in sizes if name != SCATTERED[2]]}
    if light.scattered is not None:
        left["scatter"] = [name for name in sizes if name not in SCATTERED[:2]]
    error = {rung: float(sum(_size(sizes[name]) for name in names)) for rung, names in left.items()}
    passing = [rung for rung in left if error[rung] <= limit]
    if not passing:
        best = min(error, key=lambda rung: error[rung])
        worst = max(left[best], key=lambda name: _size(sizes[name]))
        shown = "by an unknown amount" if sizes[worst] is None else f"by up to {sizes[worst]:.2g} of the line's light"
        raise InputError(
            f"The rung of this modality that comes nearest, {best}, leaves out light that changes the image {shown}: {worst}.",
            where=f"{scene.name}: rtol", value=rtol, allowed=f"{error[best]:.2g} or more",
            next_step=f'raise rtol, or give fidelity="{best}" and read the capture\'s list of effects',
        )  # fmt: skip
    known = {name: float(size) for name, size in sizes.items() if size is not None}
    rung = passing[0]
    shown_error = {str(name): value for name, value in error.items() if np.isfinite(value)}
    return chosen(
        rung, shown_error, limit, max(limit, 5e-4), "the first frame's scattered light", known, supersedes=False
    )


def _size(size: float | None) -> float:
    return np.inf if size is None else size


def _noise(scene: Scene, peak: float) -> float:
    """Standard deviation of the line's brightest pixel over its light, within 1e-4 … 0.5."""
    rig = laser_line_rig(scene)
    detector = rig.detector
    index = phase_index(scene.medium, rig.wavelength_m)
    level = (ambient_e_per_s(rig, index) + detector.dark_current_e_per_s) * detector.exposure_s
    variance = peak + level + detector.read_noise_e**2 + 1.0 / (12.0 * detector.gain_dn_per_e**2)
    return float(np.clip(np.sqrt(variance) / peak, 1e-4, 0.5)) if peak > 0 else 0.5
