"""The choice of the rung: the cheapest that leaves out less than the limit, or a refusal that says what it leaves out."""

from __future__ import annotations

import numpy as np

from ...scenes.errors import InputError
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.scene import Scene
from ..choice import Choice, Rtol, chosen
from ..effect import interreflection
from .effects import scattered_sizes
from .expected import FrameLight
from .light import line_light, nodes_of
from .setting import poses_of, setting_of
from .truth import line_truth

__all__ = ["choose"]

#: Relative error of the image that sizes are taken from.
_PILOT = 0.05


def choose(scene: Scene, rtol: Rtol) -> Choice:
    """ "direct" where all that it leaves out is predicted to stay below `rtol` of the line's light.

    Raises:
        InputError: it leaves out more, or by an unknown amount; no other rung is built.
    """
    setting = setting_of(scene)
    pose = poses_of(setting.rig)[0][0]
    nodes = nodes_of(setting, pose)
    image = line_light(setting, pose, nodes, _PILOT).electrons
    light = FrameLight(line_truth(setting, pose, nodes), float(image.max(initial=0.0)))
    sizes = {name: size for name, (size, _) in scattered_sizes(scene, light).items()}
    sizes["interreflection"] = interreflection(scene)[0]
    limit = _noise(scene, light.peak) if rtol == "noise" else float(rtol)
    error = float(sum(np.inf if size is None else size for size in sizes.values()))
    if error > limit:
        worst = max(sizes, key=lambda name: np.inf if sizes[name] is None else float(sizes[name] or 0.0))
        shown = "an unknown amount" if sizes[worst] is None else f"up to {sizes[worst]:.2g} of the line's light"
        raise InputError(
            f"The one rung of this modality, direct, leaves out {worst}: {shown}.",
            where=f"{scene.name}: rtol", value=rtol, allowed=f"{error:.2g} or more",
            next_step='raise rtol, or give fidelity="direct" and read the capture\'s list of effects',
        )  # fmt: skip
    known = {name: float(size) for name, size in sizes.items() if size is not None}
    return chosen("direct", {"direct": error}, limit, max(limit, 5e-4), "closed forms of the scattered light", known)


def _noise(scene: Scene, peak: float) -> float:
    """Standard deviation of the line's brightest pixel over its light, within 1e-4 … 0.5."""
    rig = laser_line_rig(scene)
    detector = rig.detector
    level = (rig.ambient_e_per_s + detector.dark_current_e_per_s) * detector.exposure_s
    variance = peak + level + detector.read_noise_e**2 + 1.0 / (12.0 * detector.gain_dn_per_e**2)
    return float(np.clip(np.sqrt(variance) / peak, 1e-4, 0.5)) if peak > 0 else 0.5
