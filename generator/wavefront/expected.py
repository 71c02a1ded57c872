"""What is expected of every frame and of the reference, with the truth; and their detector."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...optics.reconstruction.unwrapped import least_squares_phase
from ...scenes.errors import InputError
from ...scenes.medium_index import phase_index
from ...scenes.rigs.wavefront import wavefront_rig
from ...scenes.rigs.wavefront_geometry import Lattice, lattice_of
from ...scenes.rigs.wavefront_spec import WavefrontRig
from ...scenes.scene import Scene
from ..detector import detect, fixed_pattern
from ..effect import no_light
from ..model import Expected
from ..request import Request
from .cells import cells_for
from .field import Pupils
from .imager import blurred_chart, chart, seen_chart
from .light import coordinates, echoes, pedestal, reflectors
from .propagated import Waves
from .scintillation import rytov_of
from .sources import turbulence_truth
from .speckle import Speckle
from .spots import spot_image
from .truth import Projector, irradiances, slopes

__all__ = ["Sensed", "expect", "read", "spread_within"]

Float = NDArray[np.float64]

#: Exposures of the reference that are drawn together, and what tells their random streams from those of frames.
_AT_ONCE, _REFERENCE_KEY = 16, 1 << 40


@dataclass(frozen=True, eq=False)
class Sensed:
    """What the effects are judged by. flux (frame, lenslet), pedestal (frame): photoelectrons; spread_rad: rms of the phase within
    lenslets about their mean slope, the greatest over frames; reference: expected photoelectrons (rows, cols) of an exposure;
    cells (number of a lenslet's side, predicted error); rytov: predicted variance of log irradiance; images (frame, side, side):
    expected photoelectrons of the camera beside the lenslets, if there is one."""

    flux: Float
    pedestal: Float
    spread_rad: float
    reference: NDArray[np.float32]
    cells: tuple[int, float]
    rytov: float
    images: Float | None = None


def expect(scene: Scene, request: Request) -> Expected[Sensed]:
    """Expected photoelectrons of every frame, ambient and scattered light included and dark current not, with the truth.

    The truth is that of the reflector that sends most light through the frame's gate. Raises InputError for an impossible scene.
    """
    rig = wavefront_rig(scene)
    lattice, lit, coords = lattice_of(rig), lattice_of(rig, every=True), coordinates(scene)
    delay = np.asarray(coords["delay"])
    per_lenslet, level = echoes(scene, delay, request.seed, request.capture_key), pedestal(scene, delay)
    pupils = Pupils(rig, lattice, request.seed, request.capture_key)
    shape = (rig.frames.count, rig.camera.rows, rig.camera.cols)
    electrons = np.empty(shape, dtype=np.float32)
    truth = _Truth(rig, lattice)
    ranges = [one.range_m for one in reflectors(scene)]
    farthest = max(ranges, default=0.0)
    rytov = rytov_of(rig, farthest, scene.medium)
    cells = _cells(rig, farthest, request)
    images: list[Float] = []
    wavelength_m = rig.wavelength_m / phase_index(scene.medium, rig.wavelength_m)
    waves = Waves(rig, pupils, wavelength_m)
    speckle = Speckle(rig, pupils.size, pupils.step_m, wavelength_m, request.seed, request.capture_key)
    for frame in range(rig.frames.count):
        image = np.full(shape[1:], level[frame])
        light = np.zeros(lattice.row.size)
        main = int(np.argmax(per_lenslet[frame]))
        for number, at in enumerate(ranges):
            if per_lenslet[frame, number] <= 0.0 and number != main:
                continue
            field, phase = waves.at(frame, at)
            if per_lenslet[frame, number] > 0.0:
                for share, part in speckle.parts(frame, at):
                    bright = share * float(per_lenslet[frame, number])
                    image += spot_image(rig, lit, np.asarray(field * part), bright, request.rung, cells=cells[0])
            _refuse_coarse(scene, phase, lattice)
            light = light + per_lenslet[frame, number] * irradiances(field, lattice)
            if number == main:
                truth.add(field, phase, even=waves.even(at))
                if rig.imager is not None:
                    images.append(blurred_chart(rig.imager, field[1:-1, 1:-1], lattice.mask))
        truth.lit(light)
        electrons[frame] = image
    flat = np.ones((len(lattice.grid_m) + 2,) * 2, complex)
    # The reference is taken through the gate at the delay that lets most light through.
    best = int(np.argmax(per_lenslet.sum(axis=1)))
    reference = spot_image(rig, lit, flat, float(per_lenslet[best].sum()), request.rung, cells=cells[0]) + level[best]
    held = truth.arrays() | {"truth_background": level + _dark(rig)}
    if ranges:
        held |= turbulence_truth(rig, pupils, delay, np.array(ranges)[np.argmax(per_lenslet, axis=1)])
    if rig.imager is not None:
        held["truth_image"] = chart(rig.imager.side)
    if request.truth_electrons:
        held["truth_electrons"] = electrons + np.float32(_dark(rig))
    dark = not per_lenslet.any()
    warnings = (no_light(scene, "frame", "the gate"),) if dark else ()
    stacked = np.stack(images) if images else None
    sensed = Sensed(held["truth_flux"], level, truth.spread, reference.astype(np.float32), cells, rytov, stacked)
    return Expected(electrons, coords, held, 0, sensed, warnings)


def _cells(rig: WavefrontRig, range_m: float, request: Request) -> tuple[int, float]:
    """Cells of a lenslet's side and their predicted error; the rung geometric has none."""
    if request.rung == "geometric":
        return rig.pupil.samples, 0.0
    return cells_for(rig, range_m, request.rung, request.error)


def _refuse_coarse(scene: Scene, phase: Float, lattice: Lattice) -> None:
    """Refuse a phase whose neighbouring samples inside the pupil differ by more than half a turn: its field is that of another."""
    inner = np.where(lattice.mask, phase[1:-1, 1:-1], np.nan)
    steepest = max(float(np.nanmax(np.abs(np.diff(inner, axis=axis)), initial=0.0)) for axis in (0, 1))
    if steepest > np.pi:
        raise InputError(
            "The samples of the pupil are too far apart for the wavefront: neighbours differ by more than half a turn.",
            where=f"{scene.name}: rig.pupil.samples", value=f"{steepest:.3g} rad", allowed=f"{np.pi:.3g} rad or less",
            next_step="raise rig.pupil.samples, or lower the aberration or the turbulence",
        )  # fmt: skip


def _dark(rig: WavefrontRig) -> float:
    """Dark electrons of a pixel in one frame that join before the read noise, in photoelectrons; none behind an intensifier."""
    return 0.0 if rig.detector.intensifier is not None else rig.detector.dark_current_e_per_s * rig.detector.exposure_s


class _Truth:
    """The truth of the frames, one after the other."""

    def __init__(self, rig: WavefrontRig, lattice: Lattice) -> None:
        self._rig, self._lattice = rig, lattice
        self._projector = Projector(lattice, rig.pupil.diameter_m, rig.pupil.modes)
        self._held: dict[str, list[Any]] = {name: [] for name in ("field", "slope", "phase", "zernike", "flux")}
        self.spread = 0.0

    def add(self, field: NDArray[np.complex128], screens: Float, *, even: bool) -> None:
        """The main reflector's light; of `even` light the phase is that of the screens, of other light that of the field."""
        held, lattice = self._held, self._lattice
        own = field[1:-1, 1:-1]
        phase = screens[1:-1, 1:-1] if even else least_squares_phase(own, lattice.mask)
        held["field"].append(np.where(lattice.mask, own, 0.0).astype(np.complex64))
        held["slope"].append(slopes(field, lattice, self._rig.wavelength_m))
        held["phase"].append(self._projector.shown(phase))
        held["zernike"].append(self._projector.coefficients(phase))
        self.spread = max(self.spread, spread_within(screens[1:-1, 1:-1], lattice))

    def lit(self, light: Float) -> None:
        """Photoelectrons (lenslet) of all reflectors."""
        self._held["flux"].append(light)

    def arrays(self) -> dict[str, Any]:
        """{variable: (frame, …)}."""
        return {f"truth_{name}": np.stack(values) for name, values in self._held.items()}


def spread_within(phase: Float, lattice: Lattice) -> float:
    """rms [rad] over the used lenslets of the phase about its best plane in each."""
    samples = lattice.samples
    if lattice.cover is not None:
        return _spread_in(phase, lattice)
    across = len(lattice.grid_m) // samples
    tiles = phase.reshape(across, samples, across, samples).transpose(0, 2, 1, 3)[lattice.row, lattice.col]
    t = (np.arange(samples) - 0.5 * (samples - 1)) / max(samples - 1, 1)
    x, y = np.broadcast_to(t, (samples, samples)), np.broadcast_to(t[:, None], (samples, samples))
    basis = np.stack([np.ones_like(x), x, y]).reshape(3, -1)
    flat = tiles.reshape(len(tiles), -1)
    rest = flat - flat @ np.linalg.pinv(basis) @ basis
    return float(np.sqrt(np.mean(rest**2)))


def _spread_in(phase: Float, lattice: Lattice) -> float:
    """As `spread_within`, of lenslets that are no squares: weighted sums over the samples of each."""
    x, y = np.broadcast_arrays(lattice.grid_m[None, :], lattice.grid_m[:, None])
    unit = lattice.step_m * lattice.samples
    basis = np.stack([np.ones_like(x), x / unit, y / unit])
    # About each lenslet's own centre, so that large arrays lose no digits.
    one = np.stack([np.ones(len(lattice.x_m)), lattice.x_m / unit, lattice.y_m / unit])
    sums = np.stack([[lattice.totals(a * b) for a in basis] for b in basis])
    pulls = np.stack([lattice.totals(a * phase) for a in basis])
    shift = np.zeros((len(lattice.x_m), 3, 3)) + np.eye(3)
    shift[:, 1, 0], shift[:, 2, 0] = -one[1], -one[2]
    normal = shift @ sums.transpose(2, 0, 1) @ shift.transpose(0, 2, 1)
    pull = np.einsum("lij,jl->li", shift, pulls)
    fit = np.linalg.solve(normal, pull[:, :, None])[:, :, 0]
    rest = lattice.totals(phase**2) - (fit * pull).sum(axis=1)
    return float(np.sqrt(max(float(rest.sum() / normal[:, 0, 0].sum()), 0.0)))


def read(scene: Scene, expected: Expected[Sensed], request: Request) -> dict[str, NDArray[Any]]:
    """Counts of the frames, and the mean of the reference's exposures, which the same detector draws."""
    rig = wavefront_rig(scene)
    pattern = fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols)
    number = rig.frames.reference_exposures
    counts = detect(expected.electrons, rig.detector, pattern, request.seed, request.capture_key)
    total = np.zeros(expected.light.reference.shape)
    # Streams of their own: the key of the capture, moved.
    for first in range(0, number, _AT_ONCE):
        some = np.repeat(expected.light.reference[None], min(_AT_ONCE, number - first), axis=0)
        key = request.capture_key ^ (_REFERENCE_KEY + first)
        total += detect(some, rig.detector, pattern, request.seed, key).sum(axis=0, dtype=np.float64)
    drawn: dict[str, NDArray[Any]] = {"counts": counts, "reference": (total / number).astype(np.float32)}
    if rig.imager is not None and expected.light.images is not None:
        drawn["image"] = np.stack(
            [
                seen_chart(rig.imager, mean, frame, request.seed, request.capture_key)
                for frame, mean in enumerate(expected.light.images)
            ]
        )
    return drawn
