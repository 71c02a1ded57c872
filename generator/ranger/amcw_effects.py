"""The catalogue of effects of amplitude-modulated captures."""

from __future__ import annotations

from ...scenes.rigs.amcw import amcw_rig
from ...scenes.scene import Scene
from ..effect import Effect, effect
from ..model import Expected
from .amcw_samples import amcw_ranger
from .effects import common_effects
from .footprint import Footprint

__all__ = ["amcw_effects"]


def amcw_effects(scene: Scene, expected: Expected[Footprint], rung: str) -> list[Effect]:
    """Every catalogued effect of an AMCW capture at the rung."""
    rig = amcw_rig(scene)
    return [
        *common_effects(scene, amcw_ranger(scene), expected, rung),
        effect("power fluctuation", bool(rig.laser.power_fluctuation), rig.laser.power_fluctuation, "rms per shot"),
        effect("harmonics of the modulation", False, 0.0, "laser and reference are pure cosines"),
        effect("ambiguity of the phase", True, None, "phases repeat every half modulation wavelength"),
        effect("read noise", True, None, "Gaussian"),
        effect("multi-path phasors of the footprint", True, None, "rays add as phasors"),
    ]
