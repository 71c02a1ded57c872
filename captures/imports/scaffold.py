"""A mapping with what the files tell, and question marks where they do not."""

from __future__ import annotations

from pathlib import Path

from ..layouts import LAYOUTS, layout_of
from .files import read_recording
from .recording import Recording

__all__ = ["scaffold"]

_MOST_FACTS = 40


def scaffold(files: tuple[Path, ...], modality: str = "") -> str:
    """The TOML text of a mapping for these files.

    Main arguments:
        files: of one recording; the first one is looked at closely. modality: what they are of; "" leaves a question mark.

    Raises:
        InputError: a file that cannot be read, or an unknown modality.
    """
    first = read_recording(files[0])
    lines = [
        '# A mapping of these files. Replace each "?"; `beambench import` tells which are left (docs/importing.md).',
        *(f"#   {path.name}" for path in files),
        *_told(first),
        "schema_version = 1",
        'title = ""',
        'source = ""            # where the recording comes from, and its licence',
        f'modality = "{modality or "?"}"      # {", ".join(LAYOUTS)}',
        'truth_kind = "none"    # none, surveyed, reference-instrument, reference-algorithm',
        "averaged = false       # true: counts are means of several exposures, or processed",
        "",
    ]
    lines += _variables(first, files, modality)
    lines += [
        "[rig]",
        'scene = "?"            # a scene whose rig this is like (beambench scenes list), or a table [rig.declared]',
        "                       # as docs/declared-rig.md has it; `unknown = [\"path\", …]` states values that nobody knows",
        'file = ""              # a rig file of `beambench calibrate`, over it',
        "",
    ]  # fmt: skip
    return "\n".join(lines)


def _told(recording: Recording) -> list[str]:
    arrays = [
        f"#   array {name!r}: {array.dtype} {array.shape}" + (f", axes {list(recording.axes)}" if k == 0 and recording.axes else "")
        + (f", unit {recording.units[name]}" if name in recording.units else "")
        for k, (name, array) in enumerate(recording.arrays.items())
    ]  # fmt: skip
    facts = [f"#   {name} = {value!r}"[:118] for name, value in list(recording.header.items())[:_MOST_FACTS]]
    return ["# The first file holds:", *arrays, *(["# Its header says:", *facts] if facts else [])]


def _variables(recording: Recording, files: tuple[Path, ...], modality: str) -> list[str]:
    layout = layout_of(modality) if modality else None
    name = layout.data if layout else "?"
    main = next(iter(recording.arrays))
    axes = list(recording.axes) if recording.axes else ["?"] * next(iter(recording.arrays.values())).ndim
    head = (
        [f"[data.{name}]"]
        if layout
        else ["# counts of a camera, signal of a photodetector, samples of phases", "[data.counts]"]
    )
    lines = [
        *head,
        "files = [" + ", ".join(f'"{path.name}"' for path in files) + "]",
        *([f'array = "{main}"'] if len(recording.arrays) > 1 else []),
        "axes = [" + ", ".join(f'"{axis}"' for axis in axes) + "]     # of one file's array, in its order",
        f'units = "{recording.units.get(main, "?")}"           # DN, V, A, electron',
        "",
    ]
    for variable in [v for v in layout.variables if v.role == "coord" and v.required] if layout else []:
        known = variable.name if variable.name in recording.arrays else ""
        lines.append(f"[coords.{variable.name}]     # ({', '.join(variable.dims)}): {variable.long_name}")
        if known:
            lines.append(f'array = "{known}"')
        else:
            lines.append('values = "?"           # a number for all, a list, or: even = { start = …, step = … }')
        if variable.units != ("1",):
            lines.append(f'units = "{recording.units.get(known, "?")}"')
        lines.append("")
    return lines
