"""Scene in, capture out: the forward model reads as detector(gate(echoes(scene)))."""

from __future__ import annotations

import hashlib
import json
import warnings
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..captures.build import make_capture
from ..optics.correlation import waveforms
from ..optics.correlation.gate_maps import gate_offset_map
from ..scenes.declared import declared_rig
from ..scenes.errors import InputError
from ..scenes.rigs.gated import gated_rig
from ..scenes.sampling import optics_gate
from ..scenes.scene import Scene
from .detector import detect, fixed_pattern
from .gated.direct import DirectScene, gate_tables, render_direct
from .gated.effects import catalogue
from .gated.scatter import forward_electrons, halo_electrons, render_scatter, scattered_electrons
from .random import Stage, generator
from .rays.returns import render_stack
from .rays.trace import Tracer

if TYPE_CHECKING:
    import xarray as xr

    from .gated.choose import Choice

__all__ = [
    "GenerationWarning", "capture_key_of", "expected_electrons", "generate", "slice_coordinates", "slice_settings",
]  # fmt: skip

RUNGS = ("direct", "scatter", "full", "auto")


class GenerationWarning(UserWarning):
    """The capture was made, but a user should look at the scene."""


def capture_key_of(*parts: Any) -> int:
    """A 63-bit key from (scene, stress, level): the same everywhere, whatever the order of the run."""
    text = json.dumps(parts, sort_keys=True, default=lambda o: o.model_dump(mode="json"))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def generate(
    scene: Scene,
    *,
    seed: int,
    capture_key: int | None = None,
    fidelity: Literal["direct", "scatter", "full", "auto"] = "direct",
    rtol: float | Literal["noise"] = 3e-3,
    truth_electrons: bool = False,
    truth_components: bool = False,
    tracer: Tracer | None = None,
) -> xr.Dataset:
    """Generate one capture with its truth.

    Main arguments:
        scene: what is there, and what the rig is declared to be.
        seed: with `capture_key`, names every random number.
    Other arguments:
        capture_key: index in a data set; by default the hash of the scene.
        fidelity: the rung of the ladder; "direct" is one bounce without scattered light, "scatter" adds what the water
            scatters forward and back, "full" adds all that "direct" leaves out by tracing paths,
            "auto" takes the cheapest rung whose predicted error is below rtol.
        rtol: relative error of the expected stack aimed at by sub-pixel sampling, and by the number of paths; with "auto"
            also "noise": one standard deviation of the detector's noise.
        truth_electrons: also keep the noise-free expectation of every sample.
        truth_components: also keep the stacks that the lamp's light is the sum of: truth_direct, truth_interreflection,
            truth_single (scattered once) and truth_multiple; with the full rung only.
        tracer: reuse a tracer of the same target.

    Raises:
        InputError: an impossible scene, an unreadable mesh, an unknown rung.
    Warns:
        GenerationWarning: the target lies outside every gate; scattered light that the rung leaves out is not small.
    """
    if fidelity not in RUNGS:
        raise InputError("There is no such rung.", where="fidelity", value=fidelity, allowed=", ".join(RUNGS))
    if rtol == "noise" and fidelity != "auto":
        raise InputError("Only the choice of a rung goes by noise.", where="rtol", value=rtol, allowed="1e-6 … 0.5")
    if rtol != "noise" and not 1e-6 <= rtol <= 0.5:
        raise InputError("rtol is a fraction.", where="rtol", value=rtol, allowed="1e-6 … 0.5")
    if seed < 0:
        raise InputError("A seed is not negative.", where="seed", value=seed, allowed="0, 1, 2, …")
    key = capture_key_of(scene) if capture_key is None else capture_key
    if scene.modality != "gated" and fidelity == "full":
        raise InputError(
            "This rung is built for gated scenes only.", where=f"{scene.name}: fidelity", value=fidelity,
            allowed='"direct", "scatter", "auto"',
        )  # fmt: skip
    arguments = {
        "seed": seed, "capture_key": key, "fidelity": fidelity, "rtol": rtol, "truth_electrons": truth_electrons,
    }  # fmt: skip
    if truth_components:
        arguments["truth_components"] = True
        if fidelity != "full" or scene.modality != "gated":
            raise InputError(
                "Light is kept apart by the full rung of gated scenes only.", where=f"{scene.name}: truth_components",
                value=fidelity, next_step='fidelity="full"',
            )  # fmt: skip
    choice: Choice | None = None
    if fidelity == "auto":
        from .gated.choose import choose

        choice = choose(scene, rtol, seed, key)
        # The rung's sampling may take half, so that it and what the rung leaves out stay below rtol together.
        fidelity, rtol = choice.rung, choice.rtol * (1.0 if choice.rung == "full" else 0.5)
    assert not isinstance(rtol, str)
    if scene.modality != "gated":
        from .ranger.amcw import generate_amcw
        from .ranger.waveform import generate_waveform

        made = (generate_waveform if scene.modality == "waveform" else generate_amcw)(
            scene, seed=seed, key=key, rtol=rtol, truth_electrons=truth_electrons, tracer=tracer, rung=fidelity
        )
        if choice is not None:
            made.attrs["fidelity"] = json.dumps(json.loads(made.attrs["fidelity"]) | {"chosen": choice.record()})
        return made
    _check_stress_models(scene, fidelity)
    scatter = render_scatter(scene, rtol, tracer) if fidelity == "scatter" else None
    share = rtol
    if fidelity == "full":
        from .gated.full import SAMPLING

        share = SAMPLING * rtol
    direct = render_direct(scene, share, tracer) if scatter is None else scatter.direct
    coords = slice_coordinates(scene)
    rig = gated_rig(scene)
    screen: DirectScene | None = None
    if rig.screen is not None:
        from .gated.screen import behind_screen

        direct, screen = behind_screen(scene, direct, share)
    light, ambient = expected_electrons(scene, direct, coords, seed, key, share)
    _warn_if_dark(scene, light, ambient, coords)
    background: NDArray[Any] = ambient
    if screen is not None:
        veil = expected_electrons(scene, screen, coords, seed, key)[0] - ambient.astype(np.float32)[:, None, None]
        light += veil
        background = ambient.astype(np.float32)[:, None, None] + veil
    if scatter is not None and scatter.phase is not None:
        veil = scattered_electrons(scene, scatter, coords["gate"], *slice_settings(scene, coords, seed, key))
        light += veil
        background = ambient.astype(np.float32)[:, None, None] + veil
    traced: dict[str, Any] = {}
    more_truth: dict[str, NDArray[Any]] = {}
    if fidelity == "full":
        from .gated.full import add_remainder

        settings = slice_settings(scene, coords, seed, key)
        background, traced, more_truth = add_remainder(
            scene, light, ambient, coords["gate"], *settings, share, seed, key, direct.truth, truth_components
        )
        if not traced["reached"]:
            warnings.warn(
                f"{scene.name}: {traced['samples_per_pixel']} paths per pixel leave a standard error of "
                f"{traced['standard_error']:.2g} of the stack, more than rtol {rtol:g}.",
                GenerationWarning,
                stacklevel=2,
            )
    counts = detect(light, rig.detector, fixed_pattern(rig.detector, rig.camera.rows, rig.camera.cols), seed, key)
    truth = dict(direct.truth) | more_truth
    if scatter is not None and scatter.phase is not None:
        truth["truth_halo"] = halo_electrons(scatter)
    elif fidelity == "full" and scene.medium.scattering_per_m > 0:
        own = np.asarray(direct.truth["truth_amplitude"], np.float64)
        truth["truth_halo"] = forward_electrons(scene, own, max(rtol, 0.02), tracer)
    dark = rig.detector.dark_current_e_per_s * rig.detector.exposure_s
    truth["truth_background"] = background + background.dtype.type(dark if rig.detector.intensifier is None else 0.0)
    if truth_electrons:
        truth["truth_electrons"] = light + np.float32(dark if rig.detector.intensifier is None else 0.0)
    effects = catalogue(scene, direct, fidelity)
    if choice is not None:
        traced |= {"chosen": choice.record()}
        for effect in effects:
            if effect["name"] in choice.sizes:
                effect |= {"predicted_relative_size": choice.sizes[effect["name"]], "basis": choice.basis}
    for effect in effects:
        if not effect["modelled"] and (effect["predicted_relative_size"] or 0) > 0.1:
            warnings.warn(
                f"{scene.name}: {effect['name']} is left out by the rung '{fidelity}' and is predicted to change the "
                f"signal by {effect['predicted_relative_size']:.0%}.",
                GenerationWarning,
                stacklevel=2,
            )
    from ..captures.provenance import provenance

    declared = declared_rig(scene)
    coords["delay"] = coords.pop("setting") + declared["t0_s"]
    coords.pop("actual")
    return make_capture(
        "gated",
        data={"counts": counts},
        coords=coords,
        truth=truth,
        attrs={
            "rig": declared,
            "truth_scene": scene.model_dump(mode="json"),
            "truth_kind": "rendered",
            "seed": seed,
            "capture_key": key,
            "fidelity": {"rung": fidelity, "rtol": rtol, "rays": direct.rays, **traced, "effects": effects},
            "truth_materials": [item.name for item in scene.target],
            "provenance": provenance(arguments),
        },
    )


def slice_coordinates(scene: Scene) -> dict[str, Any]:
    """Per-slice coordinates; `setting` is what the delay generator was set to, `actual` the optical delay."""
    rig = gated_rig(scene)
    spec = rig.delays
    ramp = np.repeat(spec.start_s + spec.step_s * np.arange(spec.count), spec.repeats)
    gates = len(rig.gates)
    lit = np.tile(ramp, gates)
    gate = np.repeat(np.arange(gates), len(ramp))
    setting = np.concatenate([lit, np.full(spec.laser_off, spec.start_s)])
    gate = np.concatenate([gate, np.zeros(spec.laser_off, dtype=int)])
    total = len(setting)
    return {
        "setting": setting,
        "actual": setting + rig.t0_s,
        "gate": gate.astype(np.int32),
        "pulses": np.full(total, rig.pulses_per_slice, dtype=np.int32),
        "laser_on": np.arange(total) < len(lit),
        "time": np.arange(total) * rig.detector.exposure_s,
        "valid": np.ones(total, dtype=bool),
    }


def slice_settings(
    scene: Scene, coords: dict[str, Any], seed: int, key: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """True optical delay [s] and relative pulse energy (0: laser off) of every slice.

    Pulse energy fluctuates per slice (mean of the slice's pulses), and the delay jitters per slice; both are drawn
    here, because they are common to all pixels. The draws are named, so that every caller gets the same.
    """
    laser = gated_rig(scene).laser
    slices = len(coords["actual"])
    energy = np.ones(slices)
    if laser.energy_fluctuation:
        draw = generator(seed, key, Stage.ENERGY).standard_normal(slices)
        energy = np.maximum(1 + laser.energy_fluctuation * draw, 0.0)
    delay = coords["actual"].copy()
    if laser.jitter_frame_s:
        delay += laser.jitter_frame_s * generator(seed, key, Stage.JITTER).standard_normal(slices)
    return delay, energy * coords["laser_on"]


def _check_stress_models(scene: Scene, rung: str) -> None:
    """A moving rig and a screen before the target are modelled by the direct rung, one at a time."""
    rig = gated_rig(scene)
    given = [name for name in ("motion_m_per_s", "screen") if getattr(rig, name) is not None]
    if given and rung != "direct":
        raise InputError(
            "This is modelled by the direct rung only.", where=f"{scene.name}: rig.{given[0]}", value=rung,
            allowed='fidelity="direct"',
        )  # fmt: skip
    if len(given) > 1:
        raise InputError("A rig moves or has a screen, not both.", where=f"{scene.name}: rig", value=given)


def expected_electrons(
    scene: Scene, direct: DirectScene, coords: dict[str, Any], seed: int, key: int, rtol: float = 3e-3
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Expected photoelectrons (slices, rows, cols) of signal plus ambient light, and the ambient share per slice.

    Where the rig moves, every slice is traced anew to `rtol`, and `direct` is not used.
    """
    rig = gated_rig(scene)
    rows, cols = rig.camera.rows, rig.camera.cols
    slices = len(coords["actual"])
    delay, scale = slice_settings(scene, coords, seed, key)
    light = np.empty((slices, rows, cols), dtype=np.float32)
    offset = None
    if rig.gate_map is not None:
        offset = gate_offset_map(rows, cols, rig.gate_map.iris_s, rig.gate_map.skew_s)
    areas = np.array([waveforms.gate_area(optics_gate(gate)) for gate in rig.gates])
    background = rig.ambient_e_per_s * areas[coords["gate"]] * coords["pulses"]
    tables = gate_tables(scene)
    if rig.motion_m_per_s is not None:
        from .gated.motion import moving_stack

        flat = light.reshape(slices, -1)
        moving_stack(scene, coords["time"], coords["gate"], tables, delay, scale, offset, rtol, flat)
        tables = []
    for number, table in enumerate(tables):
        mine = np.flatnonzero(coords["gate"] == number)
        if len(mine) == slices:
            render_stack(direct.returns, table, delay, scale, offset, light.reshape(slices, -1))
        else:
            part = np.empty((len(mine), rows * cols), dtype=np.float32)
            render_stack(direct.returns, table, delay[mine], scale[mine], offset, part)
            light[mine] = part.reshape(-1, rows, cols)
    light += background.astype(np.float32)[:, None, None]
    return light, background


def _warn_if_dark(
    scene: Scene, light: NDArray[np.float32], background: NDArray[np.float64], coords: dict[str, Any]
) -> None:
    signal = light.max(axis=(1, 2)) - background
    if signal.max() <= 0:
        window = coords["actual"][coords["laser_on"]]
        warnings.warn(
            f"{scene.name}: no light reaches any slice: the target is not hit, not lit, or outside every gate "
            f"(delays {window.min():.4g} … {window.max():.4g} s).",
            GenerationWarning,
            stacklevel=3,
        )
