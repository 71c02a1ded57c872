"""Automatic exposure and gain: the settings of every frame, and the expectation and counts that they give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.rigs.laser_line import LaserLineRig, laser_line_rig
from ...scenes.rigs.laser_line_exposure import AutoExposure
from ...scenes.scene import Scene
from ..model import Expected

__all__ = ["control", "exposed", "frame_settings"]

Float = NDArray[np.float64]

#: Steps of the control before a frame that counts as settled.
_SETTLING = 200


@dataclass(frozen=True)
class _Camera:
    """What the control sees: from the electrons of the brightest pixel at the detector's own exposure to its count."""

    auto: AutoExposure
    exposure_s: float
    gain_dn_per_e: float
    offset_dn: float
    full_well_e: float
    top_dn: float

    def within(self, product: float) -> tuple[float, float]:
        """(factor of the exposure, gain) whose product is `product`, exposure first, within the limits."""
        low, high = (limit / self.exposure_s for limit in self.auto.exposure_s)
        factor = float(np.clip(product, low, high))
        return factor, float(np.clip(product / factor, *self.auto.gain))

    def level_dn(self, electrons: float, setting: tuple[float, float]) -> float:
        """The brightest pixel's count without noise."""
        held = min(electrons * setting[0], self.full_well_e)
        return min(self.offset_dn + held * self.gain_dn_per_e * setting[1], self.top_dn)

    def next(self, electrons: float, setting: tuple[float, float]) -> tuple[float, float]:
        """The setting after a frame."""
        signal = max(self.level_dn(electrons, setting) - self.offset_dn, 1.0)
        ratio = (self.auto.target_dn - self.offset_dn) / signal
        return self.within(setting[0] * setting[1] * ratio**self.auto.speed)


def control(rig: LaserLineRig, brightest_e: Float) -> tuple[Float, Float]:
    """(factor of the exposure, gain) of every frame (frame).

    Main arguments:
        brightest_e: electrons of each lit frame's brightest pixel at the detector's own exposure, dark ones included.
    """
    auto, detector = rig.auto_exposure, rig.detector
    assert auto is not None
    camera = _Camera(
        auto, detector.exposure_s, detector.gain_dn_per_e * (detector.intensifier.gain if detector.intensifier else 1.0),
        detector.offset_dn, detector.full_well_e, float(2**detector.adc_bits - 1),
    )  # fmt: skip
    setting = camera.within(1.0)
    if auto.start == "settled":
        for _ in range(_SETTLING):
            setting = camera.next(float(brightest_e[0]), setting)
    settings = []
    for electrons in brightest_e:
        settings.append(setting)
        setting = camera.next(float(electrons), setting)
    settings += [settings[-1]] * rig.frames.laser_off
    factor, gain = np.array(settings).T
    return factor, gain


def exposed(scene: Scene, expected: Expected[Any]) -> Expected[Any]:
    """The expectation with every frame's own exposure; the coordinates `exposure` [s] and `gain` say which. Without automatic
    exposure it is what it was."""
    rig = laser_line_rig(scene)
    if rig.auto_exposure is None:
        return expected
    dark = rig.detector.dark_current_e_per_s * rig.detector.exposure_s
    lit = expected.electrons[: rig.frames.lit]
    factor, gain = control(rig, lit.reshape(len(lit), -1).max(axis=1).astype(np.float64) + dark)
    truth = dict(expected.truth)
    for name in ("truth_amplitude", "truth_background", "truth_electrons", "truth_standard_error"):
        if name in truth:
            scale = factor.reshape(-1, *[1] * (truth[name].ndim - 1))
            truth[name] = (truth[name] * scale).astype(truth[name].dtype)
    electrons = expected.electrons * factor[:, None, None].astype(np.float32)
    coords = expected.coords | {"exposure": rig.detector.exposure_s * factor, "gain": gain}
    return replace(expected, electrons=electrons, coords=coords, truth=truth)


def frame_settings(rig: LaserLineRig, coords: Mapping[str, Any]) -> dict[str, Float]:
    """What the detector is told of the frames' own exposure and gain; nothing where they are the declared ones."""
    if rig.auto_exposure is None:
        return {}
    return {
        "exposure_factor": np.asarray(coords["exposure"]) / rig.detector.exposure_s, "gain_factor": np.asarray(coords["gain"]),
    }  # fmt: skip
