"""The field of the light in the pupil by split-step propagation: phase and amplitude, with branch points where it has zeros.

A flat wave goes to the mirror and back, through each layer twice; in between it propagates by the angular spectrum of the
wavelength in the water. The wave of a point on a diffuse target at R is, in coordinates that spread with it, a flat one: a layer at
a distance d from the target has samples d/R as far apart, and from d₁ to d₂ it propagates by R²(1/d₁ − 1/d₂). The curvature itself
is left out, as it is with phase screens.

The beam ends softly outside the pupil, and light that comes near the edge of the grid is lost, so that none returns at the other
side: the hard edge of a real beam is not modelled.

Source: J. D. Schmidt, Numerical Simulation of Optical Wave Propagation, 2010, ch. 6 to 9.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from ...optics.turbulence.propagation import guard_band, split_step
from ...scenes.errors import InputError
from ...scenes.rigs.wavefront_spec import WavefrontRig
from .field import Pupils

__all__ = ["MOST_SIDE", "Waves", "propagated", "route"]

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Longest side of the grid [samples]: the plan of its screens takes 1 GB.
MOST_SIDE = 1024
#: Margin on each side of the pupil: widths √(λL), L the whole way, and of the blur λL/r0; and how much of it the beam's edge takes,
#: in √(λL). Wider ones change the mean light in the pupil by 1 % or less at Rytov's variance of 1.5 (12 draws).
_MARGIN, _BLUR, _EDGE = 1.5, 0.5, 1.0


class Waves:
    """The light of all frames in the pupil, as the rig's `propagation` has it. `wavelength_m` in the water."""

    def __init__(self, rig: WavefrontRig, pupils: Pupils, wavelength_m: float) -> None:
        self._pupils, self._wavelength_m = pupils, wavelength_m
        self._splits = rig.propagation == "split-step"

    def even(self, range_m: float) -> bool:
        """Whether the light of a reflector at `range_m` is even, and its phase that of the screens."""
        return not self._splits or not self._pupils.before(range_m)

    def at(self, frame: int, range_m: float) -> tuple[Complex, Float]:
        """(field, phase [rad] of the screens), both (side + 2, side + 2), of a frame's light from a reflector at `range_m`."""
        if not self.even(range_m):
            return propagated(self._pupils, frame, range_m, self._wavelength_m)
        phase = self._pupils.phase(frame, range_m)
        return np.exp(1j * phase), phase


def propagated(pupils: Pupils, frame: int, range_m: float, wavelength_m: float) -> tuple[Complex, Float]:
    """(field, phase [rad]), both (side + 2, side + 2), of a frame's light from a reflector at `range_m`.

    The beam has unit power in its flat part; the phase is that of the screens alone, as `Pupils.phase` has it, for a draw of its
    own. `wavelength_m` in the water. At least one layer lies before the reflector. Raises InputError for too large a grid.
    """
    size = pupils.size
    layers = pupils.before(range_m)
    way = _way(pupils.mirror, range_m, [layer.range_m for layer in layers])
    fresnel = np.sqrt(wavelength_m * way) / pupils.step_m
    blur = wavelength_m * way / pupils.step_m * sum(layer.r0_m ** (-5.0 / 3.0) for layer in layers) ** 0.6
    side = int(next_fast_len(size + 2 * int(np.ceil(_MARGIN * fresnel + _BLUR * blur))))
    if side > MOST_SIDE:
        raise InputError(
            "The light spreads over too many samples of the pupil on its way.", where="rig.propagation", value=f"{side} samples",
            allowed=f"{MOST_SIDE} or fewer",
            next_step="fewer rig.pupil.samples or lenslets, or a nearer target; or phase-screens, without scintillation",
        )  # fmt: skip
    first = (side - size) // 2
    inner = (slice(first, first + size), slice(first, first + size))
    passed = [(layer.range_m, own) for layer, own in pupils.screens(frame, range_m, side)]
    own_phase = pupils.own(frame)
    phase = own_phase.copy()
    for _, own in passed:
        phase += (2.0 if pupils.mirror else 1.0) * own[inner]
    steps = route(passed, range_m, mirror=pupils.mirror)
    beam = guard_band((side, side), min(max(_EDGE * fresnel, 1.0) / side, 0.5))
    u = split_step(beam, steps, pupils.step_m, wavelength_m, guard=beam)
    return np.asarray(u[inner] * np.exp(1j * own_phase)), phase


def route(screens: list[tuple[float, Float]], range_m: float, *, mirror: bool) -> list[tuple[float, Float | None]]:
    """Steps of `split_step` of a flat wave from the first layer that it meets: (distance [m] before it, its screen), and the last
    to the array. screens: (range [m], screen), nearest first, all nearer than a diffuse target; at least one."""
    if mirror:
        met = [(at, own) for at, own in screens] + [(2.0 * range_m - at, own) for at, own in reversed(screens)]
        end = 2.0 * range_m
    else:
        met = [(-(range_m**2) / (range_m - at), own) for at, own in reversed(screens)]
        end = -range_m
    if not met:  # every layer lies in the plane of a diffuse target
        return []
    before = [met[0][0], *(at for at, _ in met)]
    steps: list[tuple[float, Float | None]] = [(at - last, own) for (at, own), last in zip(met, before, strict=False)]
    return [*steps, (end - met[-1][0], None)]


def _way(mirror: bool, range_m: float, layers: list[float]) -> float:
    """The way [m] of a flat wave from the first layer that it meets to the array, in the coordinates of the array."""
    if not layers:
        return 0.0
    if mirror:
        return 2.0 * range_m - min(layers)
    farthest = max((at for at in layers if at < range_m), default=0.0)
    return farthest * range_m / (range_m - farthest)
