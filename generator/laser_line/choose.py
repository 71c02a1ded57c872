"""The choice of the rung: the cheapest whose predicted error is below the limit.

Where closed forms say clearly that a rung passes and that the cheaper ones do not, no light is traced. Else a pilot decides: some
rows of the image by every rung. What no rung models is added to all errors; where it alone is above the limit, the scene is
refused.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...scenes.errors import InputError
from ...scenes.medium_index import phase_index
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.rigs.laser_line_geometry import ambient_e_per_s
from ...scenes.scene import Scene
from ..choice import Choice, Rtol, Rung, chosen
from ..effect import interreflection
from ..noise import noise_variance
from ..water.phase import phase_of
from .effects import EVEN_SCATTERED, MOTION, SCATTERED, motion_blur, scattered_sizes
from .expected import FrameLight, frame_light
from .exposure import control
from .full import SAMPLING
from .pilot import Traced, pilot_rounds
from .setting import poses_of, setting_of

__all__ = ["choose"]

#: Relative error of the line's light that errors are taken from, as a share of the limit, and its bounds.
_SHARE, _FINEST, _COARSEST = 0.2, 1e-3, 0.05
#: A closed form decides where it is this far from the limit, as a factor.
_CLEAR = 2.0
#: A rung whose interval still holds the limit when the paths are used up passes below this share of it.
_MARGIN = 0.85
#: Least relative error that a rung is rendered to.
_SAMPLED = 5e-4


def choose(scene: Scene, rtol: Rtol, seed: int, capture_key: int) -> Choice:
    """The cheapest rung whose predicted error is below `rtol`; where none is, the one with the smallest.

    Main arguments:
        rtol: a fraction, rms over the image, or "noise": the noise of the line's brightest pixel over its light.
        seed, capture_key: name the pilot's random numbers.

    Raises:
        InputError: motion blur, which no rung models, is above the limit; as the full rung does.
    """
    setting = setting_of(scene)
    phase_of(scene)
    pose = poses_of(setting.rig)[0][0]
    aim = 0.1 if rtol == "noise" else float(rtol)
    light = frame_light(setting, pose, float(np.clip(_SHARE * aim, _FINEST, _COARSEST)), wide=True)
    limit = _noise(scene, float(light.line.max(initial=0.0))) if rtol == "noise" else float(rtol)
    effects = setting.rig.effects
    blur = 0.0 if effects is not None and effects.exposure_poses is not None else motion_blur(scene, light)
    _refuse_motion(scene, blur, limit, rtol)
    _refuse_even_light(scene, rtol)
    sampled = max(limit, _SAMPLED)
    known = {name: size for name, (size, _) in scattered_sizes(scene, light).items() if size is not None}
    sizes = {name: float(size) for name, size in known.items()} | {MOTION: blur}
    closed = _closed(scene, light, sizes, blur, limit)
    if closed is not None:
        rung, predicted = closed
        return chosen(rung, predicted, limit, sampled, "closed forms of scattered light", sizes, supersedes=False)
    traced = _enough(pilot_rounds(setting, pose, light, seed, capture_key), blur, limit)
    predicted = {name: error + blur for name, (error, _, _) in traced.errors.items()}
    predicted["full"] = max(SAMPLING * sampled, traced.full) + blur
    cheaper: tuple[Rung, ...] = ("direct", "scatter")
    passing = [name for name in cheaper if name in traced.errors and _passes(traced.errors[name], blur, limit)]
    rung = passing[0] if passing else "full"
    if not passing and predicted["full"] > limit:
        rung = min((*cheaper, "full"), key=lambda name: predicted.get(name, np.inf))
    basis = f"pilot of {traced.rows} rows, {traced.paths} paths in each pixel"
    return chosen(rung, predicted, limit, sampled, basis, sizes, supersedes=False)


def _closed(
    scene: Scene, light: FrameLight, sizes: dict[str, float], blur: float, limit: float
) -> tuple[Rung, dict[str, float]] | None:
    """The rung and all errors, where closed forms are enough to know; else None."""
    if interreflection(scene)[0] != 0.0:
        return None
    if light.scattered is None or not light.line.any():
        return ("direct", {"direct": blur}) if scene.medium.scattering_per_m == 0 else None
    veil, halo, rest = (sizes[name] for name in SCATTERED)
    most = {"direct": veil + halo + rest + blur, "scatter": rest + blur}
    if most["direct"] <= limit / _CLEAR:
        return "direct", most
    # The whole image holds the halo too.
    least = max(veil, halo) / (1.0 + veil + halo + rest)
    return ("scatter", most) if least > _CLEAR * limit and most["scatter"] <= limit / _CLEAR else None


def _enough(rounds: Iterator[Traced], blur: float, limit: float) -> Traced:
    """Trace until every rung's error is decided; the last round."""
    traced: Traced | None = None
    for traced in rounds:
        if all(high + blur <= limit or low + blur > limit for _, low, high in traced.errors.values()):
            break
    assert traced is not None
    return traced


def _passes(error: tuple[float, float, float], blur: float, limit: float) -> bool:
    value, low, high = (one + blur for one in error)
    return high <= limit or (low <= limit and value <= _MARGIN * limit)


def _refuse_motion(scene: Scene, blur: float, limit: float, rtol: Rtol) -> None:
    if blur > limit:
        raise InputError(
            f"No rung models what changes the image by up to {blur:.2g} of the line's light, and so leaves out light: {MOTION}.",
            where=f"{scene.name}: rtol", value=rtol, allowed=f"{blur:.2g} or more",
            next_step='raise rtol, or give fidelity="direct" and read the capture\'s list of effects',
        )  # fmt: skip


def _refuse_even_light(scene: Scene, rtol: Rtol) -> None:
    if laser_line_rig(scene).even_light_e_per_s and scene.medium.scattering_per_m > 0:
        raise InputError(
            f"No rung models what water does to even light, and so each leaves out an unknown amount of light: {EVEN_SCATTERED}.",
            where=f"{scene.name}: rtol", value=rtol,
            next_step='give fidelity="scatter" and read the capture\'s list of effects, or leave out even_light_e_per_s',
        )  # fmt: skip


def _noise(scene: Scene, peak: float) -> float:
    """Standard deviation of the line's brightest pixel over its light, within 1e-4 … 0.5, at the frames' exposure and gain. Of
    several settings of an automatic exposure the least noise counts; they are those for this peak in every frame."""
    rig = laser_line_rig(scene)
    detector = rig.detector
    lamps = ambient_e_per_s(rig, phase_index(scene.medium, rig.wavelength_m)) * detector.exposure_s
    dark = detector.dark_current_e_per_s * detector.exposure_s
    if peak <= 0:
        return 0.5
    factor, gain = np.ones(1), np.ones(1)
    if rig.auto_exposure is not None:
        factor, gain = control(rig, np.full(rig.frames.lit, peak + lamps + dark))
    noise = [
        np.sqrt(float(noise_variance(detector, (peak + lamps) * one, exposure=one, gain=other))) / (peak * one)
        for one, other in dict.fromkeys(zip(factor.tolist(), gain.tolist(), strict=True))
    ]
    return float(np.clip(min(noise), 1e-4, 0.5))
