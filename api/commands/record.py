"""The command `record`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table, size_text
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..verbs.record import Recording

__all__ = ["RECORD"]

#: The command could not measure all that it was asked for.
_GIVEN_UP = 3


def _size(made: Recording) -> int:
    import math

    import numpy as np

    planned = made.planned
    return len(planned.slots) * math.prod(planned.shape) * np.dtype(planned.recipe.dtype).itemsize


def _parts(made: Recording) -> dict[str, int]:
    parts: dict[str, int] = {}
    for slot in made.planned.slots:
        parts[slot.part] = parts.get(slot.part, 0) + 1
    return parts


def _json(made: Recording, given: Arguments) -> dict[str, Any]:
    planned, done = made.planned, made.recorded
    shown: dict[str, Any] = {
        "plan": planned.plan.plan, "title": planned.plan.title, "modality": planned.recipe.name, "shots": len(planned.slots),
        "parts": _parts(made), "elements": planned.elements, "shape": list(planned.shape), "bytes": _size(made),
        "rig": None if made.rig is None else made.rig.rig,
    }  # fmt: skip
    if done is not None:
        shown |= {
            "path": str(done.path), "done": done.done, "retakes": done.retakes, "given_up": done.given_up or None,
        }  # fmt: skip
    return shown


def _text(made: Recording, given: Arguments) -> None:
    planned, done = made.planned, made.recorded
    if done is None:
        _plan(made)
        return
    print_lines(f"{done.path}: {done.done} of {done.total} shots, {done.retakes} taken again")
    if done.given_up:
        print_lines(
            f"given up: {done.given_up}",
            "The store holds what was recorded; the rest is not valid in it.",
            f"next: the same command with --resume, or: beambench record {planned.plan.plan} --finish --overwrite -o {done.path}",
        )
    else:
        print_lines(f"next: beambench data verify {done.path}")


def _plan(made: Recording) -> None:
    planned = made.planned
    print_lines(
        f"{planned.plan.plan}: {planned.plan.title}",
        f"instrument: {planned.plan.instrument} ({planned.recipe.name})",
        "",
    )
    rows = []
    for part, count in _parts(made).items():
        own = [slot for slot in planned.slots if slot.part == part]
        named = [(role, name) for role, settings in own[0].settings.items() for name in settings]
        settings = "; ".join(f"{name} {_range([slot.settings[role][name] for slot in own])}" for role, name in named)
        rows.append((part, str(count), str(len({slot.group for slot in own})), settings))
    print_table(("part", "shots", "elements", "settings"), rows, right=("shots", "elements"))
    shape = " × ".join(map(str, planned.shape))
    print_lines("", f"{len(planned.slots)} shots of {shape}, {size_text(_size(made))}")
    if made.rig is not None:
        for name, options in made.rig.devices.items():
            print_lines(f"{name}: {options['driver']} at {options.get('address', '')}")
    print_lines("No device was touched.")


def _range(values: list[Any]) -> str:
    numbers = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
    if len(numbers) == len(values) and len(set(values)) > 1:
        return f"{min(numbers):.12g} … {max(numbers):.12g}"
    return " / ".join(dict.fromkeys(map(str, values)))


@contextmanager
def _live(quiet: bool) -> Iterator[Any]:
    """The last frame and a line of progress where standard error is a terminal; else a line now and then."""
    from ..live_frame import LiveFrame

    with LiveFrame(quiet) as live:
        yield live


def _code(made: Recording) -> int:
    return _GIVEN_UP if made.recorded is not None and made.recorded.given_up else 0


RECORD = command(
    "record",
    "record:record",
    View(_text, _json, _code),
    examples="Examples:\n  beambench record gated-demo --rig emulator -o real.zarr\n"
    "  beambench record gated-demo --rig emulator --plan\n"
    "  beambench record gated-demo --rig my-rig.toml -o real.zarr --resume\n"
    "  beambench record gated-demo --set scan.repeats=5 --rig my-rig.toml -o real.zarr",
    progress=_live,
)
