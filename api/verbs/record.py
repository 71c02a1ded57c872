"""`beambench record`: a plan, carried out with the devices of a rig, becomes an ordinary store of captures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..output import default_out

if TYPE_CHECKING:
    from ..captures.recording.plan import Planned, RigFile
    from ..captures.recording.record import Recorded
    from ..captures.recording.session import Watch

__all__ = ["Recording", "record"]


@dataclass(frozen=True)
class Recording:
    """A plan, its rig, and what was recorded: None where the plan was only shown."""

    planned: Planned
    rig: RigFile | None
    recorded: Recorded | None = None


def record(
    source: str | Path | Mapping[str, Any],
    *,
    rig: str | Path | Mapping[str, Any] | None = None,
    overrides: Mapping[str, Any] | None = None,
    plan: bool = False,
    out: str | Path | None = None,
    resume: bool = False,
    finish: bool = False,
    overwrite: bool = False,
    progress: Watch | None = None,
) -> Recording:
    """Record a plan with the devices of a rig: each shot is on disk before the next one is fired.

    A shot is set, read back, armed, fired, read and committed with its sha256; lost packets are asked for again, silent or
    damaged shots taken again, devices that died opened again. A recording that is killed goes on with `resume`; the store that
    it becomes is an ordinary capture, in which slots that are missing are not valid.

    Main arguments:
        source: Name of a plan, or a .toml or .json file; in Python also a plan as data.
        rig: Name of a rig file, or a .toml or .json file: "emulator" is an emulated gated camera that is started for it.
        overrides: {path: value} of the plan, applied before validation.
    Other arguments:
        plan: Show what would be recorded, and touch no device.
        out: The store; ./beambench-runs/<plan>-<time> by default. It grows in `out`.recording.
        resume: Go on with a recording that was begun.
        finish: Make a store of what a recording has so far, without any device.
        overwrite: Replace an existing store.
        progress: Called after each shot with (shots done, shots in all, a few words, the last frame).

    Returns:
        `planned`, `rig`, and `recorded` with `path`, `done`, `total`, `retakes` and `given_up`.

    Raises:
        InputError: A wrong plan or rig file, a device that does not answer, an output that exists, a full disk.
    """
    from ..captures.recording.plan import load_plan, load_rig
    from ..captures.recording.record import devices_of
    from ..captures.recording.record import finish as finished
    from ..scenes.errors import InputError
    from ..scenes.places import local_path

    planned = load_plan(source, overrides)
    loaded = None if rig is None else load_rig(rig)
    if plan:
        if loaded is not None:
            devices_of(planned, loaded)
        return Recording(planned, loaded)
    if (resume or finish) and out is None:
        raise InputError("Say which recording.", where="--out", next_step="add --out STORE, an earlier output")
    place = default_out(planned.plan.plan) if out is None else local_path(out)
    if finish:
        return Recording(planned, loaded, finished(planned, place, overwrite=overwrite))
    if loaded is None:
        raise InputError(
            "Say with which devices.", where="--rig", allowed="emulator, or a rig file (.toml, .json)",
            next_step="add --rig emulator, or --plan to see what would be recorded",
        )  # fmt: skip
    return _recorded(planned, loaded, place, resume, overwrite, progress)


def _recorded(
    planned: Planned, rig: RigFile, place: Path, resume: bool, overwrite: bool, progress: Watch | None
) -> Recording:
    from ..captures.recording.record import devices_of, record
    from .emulated_rig import with_emulator

    devices_of(planned, rig)  # what is wrong with it is said before an emulated rig is started
    with with_emulator(planned, rig) as connected:
        devices = devices_of(planned, connected)
        done = record(planned, devices, place, resume=resume, overwrite=overwrite, watch=progress)
    return Recording(planned, connected, done)
