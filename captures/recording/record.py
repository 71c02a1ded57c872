"""A recording from its plan to its capture: shots into slots, slots into a store."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scenes.errors import InputError
from ..build import make_capture
from ..drivers.device import Device, Firing
from ..drivers.listing import made
from ..provenance import provenance
from ..store.publish import is_store
from ..store.writer import write
from .plan import Planned, RigFile
from .recipe import Taken
from .session import Devices, GivenUp, Session, Watch
from .slots import SlotStore, folder_of, remove_recording

__all__ = ["Recorded", "devices_of", "finish", "record"]


@dataclass(frozen=True)
class Recorded:
    """What a recording left: the store, slots done and in all, how often something was taken again, why it was given up."""

    path: Path
    done: int
    total: int
    retakes: int
    given_up: str = ""


def devices_of(planned: Planned, rig: RigFile) -> Devices:
    """The devices of a rig file, not opened. Raises InputError: a role without a device, an unknown driver or option."""
    by_name: dict[str, Device] = {}
    roles: dict[str, str] = {}
    for name, options in rig.devices.items():
        rest = {key: value for key, value in options.items() if key not in ("driver", "also")}
        by_name[name] = made(options.get("driver"), rest, f"{rig.rig}: devices.{name}")
        for role in (name, *_also(options, f"{rig.rig}: devices.{name}.also")):
            roles[role] = name
    for role in (*planned.recipe.roles, rig.trigger, *rig.settings):
        if role not in roles:
            raise InputError(
                f"The plan needs a device for the role {role!r}.", where=f"{rig.rig}: devices", value=", ".join(roles),
                allowed=", ".join(planned.recipe.roles), next_step=f'add [devices.{role}], or also = ["{role}"] to another',
            )  # fmt: skip
    if not isinstance(by_name[roles[rig.trigger]], Firing):
        raise InputError(
            "This device cannot trigger.", where=f"{rig.rig}: trigger", value=rig.trigger, allowed=", ".join(roles)
        )
    settings = {role: {**rig.settings.get(role, {}), **planned.fixed.get(role, {})} for role in roles}
    return Devices(by_name, roles, planned.recipe.roles[0], rig.trigger, settings, rig.shot_timeout_s, rig.give_up_s)


def _also(options: Mapping[str, Any], where: str) -> list[str]:
    also = options.get("also", [])
    if not isinstance(also, list) or not all(isinstance(one, str) for one in also):
        raise InputError("The further roles of a device are a list of names.", where=where, value=also)
    return also


def record(
    planned: Planned,
    devices: Devices,
    out: Path,
    *,
    resume: bool = False,
    overwrite: bool = False,
    watch: Watch | None = None,
) -> Recorded:
    """Record a plan into the store `out`.

    Raises:
        InputError: a device that does not answer at the start, or is another one; a full disk; an output that exists. What
            was recorded until then stays in `out`.recording.
    """
    store = _store(planned, out, resume, overwrite)
    given_up = ""
    try:
        todo = [number for number, line in enumerate(store.lines) if line is None]
        if todo:
            with Session(devices, store) as session:
                given_up = _taken(planned, session, store, todo, watch)
        return _published(planned, store, out, given_up)
    except KeyboardInterrupt as error:
        error.add_note(store.advice())
        raise
    finally:
        empty = store.count == 0
        store.close()
        if empty and not given_up and store.folder.is_dir():
            remove_recording(store.folder)


def finish(planned: Planned, out: Path, *, overwrite: bool = False) -> Recorded:
    """Make a capture of what a recording has so far; what is missing is not valid in it. Raises InputError."""
    if not folder_of(out).is_dir():
        raise InputError(
            "No recording with this name was begun.", where=str(folder_of(out)), next_step="record it without --finish"
        )
    store = _store(planned, out, True, overwrite)
    try:
        return _published(planned, store, out, "", whole=True)
    finally:
        store.close()


def _store(planned: Planned, out: Path, resume: bool, overwrite: bool) -> SlotStore:
    folder = folder_of(out)
    ours = resume and folder.is_dir()  # a store that stands there is the partial stack of this recording
    if out.exists() and not ((overwrite or ours) and is_store(out)):
        raise InputError("The output exists.", where=str(out), next_step="choose another --out, or add --overwrite")
    identity = {"plan": planned.plan.model_dump(mode="json"), "rig": planned.declared}
    return SlotStore(folder, len(planned.slots), planned.shape, planned.recipe.dtype, identity, resume=resume)


def _taken(planned: Planned, session: Session, store: SlotStore, todo: list[int], watch: Watch | None) -> str:
    """Take all slots that are missing; why it was given up, or nothing."""
    total = len(store.lines)
    try:
        for number in todo:
            slot = planned.slots[number]
            data = session.take(number, slot)
            if watch is not None:
                watch(store.count, total, f"{slot.part} {slot.group + 1}/{planned.elements}", data)
    except GivenUp as error:
        return str(error)
    return ""


def _published(planned: Planned, store: SlotStore, out: Path, given_up: str, whole: bool = False) -> Recorded:
    data, valid = store.read()
    retakes = sum(event["event"] == "retake" for event in store.events)
    done = int(valid.sum())
    if not done:
        raise InputError(
            "Nothing was recorded.", where=str(store.folder), value=given_up or None,
            next_step="check the devices, and add --resume",
        )  # fmt: skip
    capture = _capture(planned, store, data, valid)
    try:
        write(out, capture, overwrite=out.exists())
    except InputError as error:  # a full disk: nothing has to be recorded again
        error.add_note(store.advice())
        raise
    if whole or not given_up:
        store.close()
        remove_recording(store.folder)
    return Recorded(out, done, len(valid), retakes, given_up)


def _capture(planned: Planned, store: SlotStore, data: NDArray[Any], valid: NDArray[np.bool_]) -> Any:
    lines = [line if good else None for line, good in zip(store.lines, valid, strict=True)]
    opened = [event for event in store.events if event["event"] == "opened"]
    fixed = opened[-1]["told"] if opened else {}
    taken = Taken(planned.slots, data, valid, lines, fixed)
    built = planned.recipe.build(planned.scan, planned.scene, taken, planned.declared)
    recording = {
        "plan": planned.plan.model_dump(mode="json"),
        "opened": opened,
        "slots": [None if line is None else {key: line[key] for key in _KEPT if key in line} for line in lines],
        "events": [event for event in store.events if event["event"] != "opened"],
        "clocks": _clocks(lines),
    }
    attrs = {
        "rig": planned.declared,
        "truth_kind": "none",
        "provenance": provenance({"plan": planned.plan.plan}) | {"recording": recording},
        **({"averaged": True} if built.averaged else {}),
    }
    return make_capture(planned.recipe.name, built.data, built.coords, {}, attrs)


_KEPT = ("part", "sha256", "told", "index", "device_ns", "host_ns", "opened", "meta")


def _clocks(lines: list[Any]) -> list[dict[str, float]]:
    """The device's clock against the host's, each time that the devices were opened: host = offset + (1 + 1e-6·ppm)·device, ns, by
    least squares, with the standard error of the rate and the rms of what is left."""
    found = []
    for number in sorted({line["opened"] for line in lines if line}):
        own = [line for line in lines if line and line["opened"] == number and line["device_ns"]]
        if len(own) < 3:
            continue
        device = np.array([line["device_ns"] for line in own], np.int64)
        host = np.array([line["host_ns"] for line in own], np.int64)
        x, y = (device - device[0]).astype(float), (host - host[0]).astype(float)
        if np.ptp(x) <= 0:
            continue
        slope, shift = np.polyfit(x, y, 1)
        rest = float(np.sqrt(np.mean((y - slope * x - shift) ** 2)))
        offset = float(host[0] - device[0]) + float(shift)
        error = rest * float(np.sqrt(len(own) / (len(own) - 2) / np.sum((x - x.mean()) ** 2)))
        found.append({
            "opened": number, "shots": len(own), "offset_ns": offset, "ppm": (slope - 1) * 1e6, "ppm_error": error * 1e6,
            "rms_ns": rest,
        })  # fmt: skip
    return found
