"""The medium's phase function, which every rung above `direct` needs."""

from __future__ import annotations

from ...optics.water.phase_forms import PhaseFunction
from ...scenes.errors import InputError
from ...scenes.scene import Scene

__all__ = ["phase_of"]


def phase_of(scene: Scene) -> PhaseFunction | None:
    """The medium's phase function; None where nothing scatters.

    Raises:
        InputError: the medium scatters and has no phase function.
    """
    if scene.medium.scattering_per_m == 0.0:
        return None
    phase = scene.medium.phase
    if phase is None:
        raise InputError(
            "Scattered light needs the medium's phase function.",
            where=f"{scene.name}: medium.phase_function",
            allowed='e.g. { kind = "fournier-forand", index = 1.10, slope = 3.58 }, or a water_type of petzold1972',
            next_step='give the phase function, or use fidelity="direct"',
        )
    return phase
