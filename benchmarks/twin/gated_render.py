"""The twin of a delay scan: its expectation by the generator, and draws of it with uncertain values and noise anew."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ...estimators.calibration.gated_scan import DelayScan
from ...estimators.calibration.gated_widths import ResponseFit
from ...estimators.rig import DeclaredRig
from ...generator.checked import checked
from ...generator.detector import detect, fixed_pattern
from ...generator.gated.direct import DirectScene
from ...generator.gated.expected import expect
from ...generator.gated.stack import expected_electrons, slice_settings
from ...generator.rays.returns import Returns
from ...scenes.declared import declared_rig
from ...scenes.errors import InputError
from ...scenes.rigs.gated import gated_rig
from ...scenes.scene import Scene
from .gated_rig import Uncertain, perturbed

__all__ = ["GatedTwin", "rendered_twin", "settings_of"]

Float = npt.NDArray[np.float64]

#: Key of the random numbers of a twin; the draw is their seed.
_KEY = 0x7715


def settings_of(scan: DelayScan) -> Float:
    """What the delay generator was set to: the delays as stated less the declared time zero."""
    return np.asarray(scan.delay_s - float(scan.rig.get("t0_s") or 0.0))


@dataclass(frozen=True, eq=False)
class GatedTwin:
    """A twin of a scan.

    Main arguments:
        scene: with the twin's rig. light: its echoes, scaled to the recording's light. scattered: what water adds to a
            delay, (delay, pixel), electrons. uncertain: what is drawn anew. spread: standard errors of the echoes' amplitude
            and time where they were fitted to the recording, relative and in s; None where they are those of a scene.
        truth: maps of the scene (row, col) by name; empty for a fitted map.
        settings_s, shape: of the scan.
    """

    scene: Scene
    light: DirectScene
    scattered: npt.NDArray[np.float32]
    uncertain: Uncertain
    spread: tuple[Float, Float] | None
    truth: dict[str, Any]
    settings_s: Float
    shape: tuple[int, int]

    @cached_property
    def declared(self) -> DeclaredRig:
        """The twin's rig as estimators see it."""
        values = declared_rig(self.scene)
        return DeclaredRig(json.dumps(values, allow_nan=False), values)

    def read_with(self, scan: DelayScan) -> DelayScan:
        """A recorded scan as it is read with the twin's rig: its own pulse, gate, gain and time zero."""
        return replace(scan, delay_s=self.settings_s + gated_rig(self.scene).t0_s, rig=self.declared)

    def expected_dn(self) -> Float:
        """Counts above the dark level without noise, (delay, pixel)."""
        rig = gated_rig(self.scene)
        coords = _coordinates(self.scene, self.settings_s, 1, 0)
        still = still_scene(self.scene)
        light, ambient = expected_electrons(still, self.light, coords, 0, _KEY)
        tube = rig.detector.intensifier
        gain = rig.detector.gain_dn_per_e * (1.0 if tube is None else tube.gain)
        flat = (light - ambient.astype(np.float32)[:, None, None]).reshape(len(light), -1) + self.scattered
        return np.asarray(gain * flat, np.float64)

    def draw(self, seed: int, repeats: int, dark: int) -> DelayScan:
        """One recording of the twin: uncertain values, frames' energies and delays, and noise are drawn from the seed."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_KEY,)))
        scene = perturbed(self.scene, self.uncertain, rng)
        rig = gated_rig(scene)
        coords = _coordinates(scene, self.settings_s, repeats, dark)
        light = self.light if self.spread is None else _moved(self.light, self.spread, rng)
        # The light was matched in DN: another gain comes with inversely many electrons.
        scale = gated_rig(self.scene).detector.gain_dn_per_e / rig.detector.gain_dn_per_e
        light = replace(light, returns=replace(light.returns, amplitude=light.returns.amplitude * scale))
        expected = self._frames(scene, light, coords, seed, repeats)
        if self.scattered.any():
            _, energy = slice_settings(scene, coords, seed, _KEY)
            lit = len(self.settings_s) * repeats
            extra = np.repeat(self.scattered, repeats, axis=0) * (scale * energy[:lit, None]).astype(np.float32)
            expected[:lit] += extra.reshape(lit, *self.shape)
        chip = rig.detector.model_copy(update={"fixed_pattern_seed": seed})  # another chip of the same make
        counts = detect(expected, chip, fixed_pattern(chip, *self.shape), seed, _KEY)
        flat = counts.reshape(len(counts), -1)
        lit = len(self.settings_s) * repeats
        stack = flat[:lit].reshape(len(self.settings_s), repeats, -1)
        return DelayScan(
            stack, flat[lit:], self.settings_s + gated_rig(self.scene).t0_s, self.shape, self.declared
        )  # fmt: skip

    def _frames(
        self, scene: Scene, light: DirectScene, coords: dict[str, Any], seed: int, repeats: int
    ) -> npt.NDArray[np.float32]:
        """Expected photoelectrons (frame, row, col). Repeats of a delay differ in energy only, unless delay or rig move."""
        rig = gated_rig(scene)
        if rig.laser.jitter_frame_s or rig.laser.jitter_shot_s or rig.motion_m_per_s is not None:
            return expected_electrons(scene, light, coords, seed, _KEY)[0]
        once = _coordinates(scene, self.settings_s, 1, 1)
        electrons, ambient = expected_electrons(still_scene(scene), light, once, seed, _KEY)
        background = ambient.astype(np.float32)[0]  # one gate, and as many pulses in every frame
        _, energy = slice_settings(scene, coords, seed, _KEY)
        of = np.minimum(np.arange(energy.size) // repeats, len(electrons) - 1)
        expected = (electrons - background)[of] * energy.astype(np.float32)[:, None, None]
        return np.asarray(expected + background, np.float32)


def still_scene(scene: Scene) -> Scene:
    """The scene with a laser that neither varies in energy nor jitters from frame to frame."""
    laser = gated_rig(scene).laser.model_copy(update={"energy_fluctuation": 0.0, "jitter_frame_s": 0.0})
    return scene.model_copy(update={"rig": gated_rig(scene).model_copy(update={"laser": laser})})


def _coordinates(scene: Scene, settings_s: Float, repeats: int, dark: int) -> dict[str, Any]:
    """Coordinates of a recording in which each delay is repeated, then frames with the laser off."""
    rig = gated_rig(scene)
    lit = np.repeat(settings_s, repeats)
    delay = np.concatenate([lit, np.full(dark, settings_s[0])])
    return {
        "actual": delay + rig.t0_s,
        "gate": np.zeros(delay.size, np.int32),
        "pulses": np.full(delay.size, rig.pulses_per_slice, np.int32),
        "laser_on": np.arange(delay.size) < lit.size,
        "time": np.arange(delay.size) * rig.detector.exposure_s,
    }


def _moved(light: DirectScene, spread: tuple[Float, Float], rng: np.random.Generator) -> DirectScene:
    """Fitted echoes, moved by their standard errors."""
    held = light.returns
    amplitude = held.amplitude * np.maximum(1.0 + spread[0] * rng.standard_normal(held.amplitude.size), 0.0)
    tau = held.tau + spread[1] * rng.standard_normal(held.tau.size)
    return replace(light, returns=replace(held, amplitude=amplitude, tau=tau))


def rendered_twin(
    scene: Scene, first: DelayScan, uncertain: Uncertain, fitted: ResponseFit | None, fidelity: Any, surveyed: bool
) -> GatedTwin:
    """The twin of a scan.

    Main arguments:
        scene: with the twin's rig and the delays of the scan. first: the half that gives the level of light. uncertain: of
        the rig.
        fitted: amplitudes and times of the echoes as fitted to `first` with the twin's rig; None: those of the scene.
            surveyed: whether the times of `fitted` are those of a surveyed target.

    Raises:
        InputError: the scene shows no light where the recording does.
    """
    settings = settings_of(first)
    rig = gated_rig(scene)
    tube = rig.detector.intensifier
    gain = rig.detector.gain_dn_per_e * (1.0 if tube is None else tube.gain)
    if fitted is not None:
        return _of_map(scene, first, uncertain, fitted, gain, surveyed)
    request = checked(scene, seed=0, capture_key=_KEY, fidelity=fidelity or "direct", rtol=3e-3)
    still = still_scene(scene)
    made = expect(still, request)
    coords = _coordinates(still, settings, 1, 1)
    own, ambient = expected_electrons(still, made.light, coords, 0, _KEY)
    lit = len(settings)
    electrons = made.electrons[:lit].reshape(lit, -1)
    scattered = np.maximum(electrons - own[:lit].reshape(lit, -1), 0.0)
    if float(scattered.max(initial=0.0)) < 1e-5 * float(electrons.max()):
        scattered = np.zeros_like(scattered)
    level = first.dark.astype(np.float64).mean(axis=0)
    seen = float((first.counts.mean(axis=1) - level).sum()) / gain
    modelled = float((electrons - ambient[:lit, None]).sum())
    if not modelled > 0 or not seen > 0:
        raise InputError(
            "The scene and the recording do not show light at the same delays.", where="scene",
            value=f"{seen:.3g} photoelectrons recorded, {modelled:.3g} expected", allowed="light in both",
            next_step="check the distance of the target and rig.t0_s",
        )  # fmt: skip
    factor = seen / modelled
    returns = replace(made.light.returns, amplitude=made.light.returns.amplitude * factor)
    truth = {
        name: value
        for name, value in made.truth.items()
        if name in ("truth_range", "truth_mixed", "truth_first", "truth_last")
    }
    return GatedTwin(
        scene, replace(made.light, returns=returns), (scattered * np.float32(factor)).astype(np.float32), uncertain, None, truth,
        settings, first.shape,
    )  # fmt: skip


def _of_map(
    scene: Scene, first: DelayScan, uncertain: Uncertain, fitted: ResponseFit, gain: float, surveyed: bool
) -> GatedTwin:
    """The twin of a map of echoes, one in each pixel."""
    pixels = fitted.tau_s.size
    amplitude = np.maximum(fitted.amplitude, 0.0) / gain
    # A surveyed target's echo stays where it was surveyed: the fitted common shift is what the clause of time zero is about.
    moved = 0.0 if not surveyed or not np.isfinite(fitted.shift_s.value) else fitted.shift_s.value
    tau = fitted.tau_s - moved
    returns = Returns(np.arange(pixels + 1), amplitude, tau, np.zeros(pixels))
    relative = fitted.amplitude_sigma / np.maximum(fitted.amplitude, 1e-12)
    time = np.where(np.isfinite(fitted.tau_sigma_s), fitted.tau_sigma_s, 0.0)
    settings = settings_of(first)
    still = np.zeros((len(settings), pixels), np.float32)
    light = DirectScene(returns, {}, 0)
    return GatedTwin(scene, light, still, uncertain, (relative, time), {}, settings, first.shape)
