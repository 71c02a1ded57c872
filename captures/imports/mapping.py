"""The mapping: what the arrays of other programs' files are in a capture. Nothing is guessed: units and rig are declared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from ...scenes.base import Spec
from ...scenes.errors import InputError
from ...scenes.spec_files import find_spec_file, read_spec_file
from ...scenes.validate import validate_spec

__all__ = ["LIBRARY", "Capture", "Clean", "Even", "Mapping", "RigSource", "Tags", "Values", "load_mapping"]

#: Folder of the mappings that ship with the project.
LIBRARY = Path(__file__).parent / "library"

Name = Annotated[str, Field(min_length=1, max_length=200)]
TruthKind = Literal["none", "surveyed", "reference-instrument", "reference-algorithm"]


class Even(Spec):
    """Even values: start + step·k; their number follows from the data."""

    start: float
    step: float


class Tags(Spec):
    """Time tags of single photons, to be counted in bins of a record per shot.

    Main arguments:
        time: array or column of the tags. units: theirs, e.g. "ps"; those of the variable are of its counts.
        start_s, step_s, samples: bin k holds tags of start + (k ± ½)·step.
    Other arguments:
        shot: array or column of the shot's number from 0; absent: all tags are of one shot. shots: their number.
    """

    time: Name
    units: Name
    start_s: float
    step_s: Annotated[float, Field(gt=0)]
    samples: Annotated[int, Field(ge=4, le=65536)]
    shot: str = ""
    shots: Annotated[int, Field(ge=1, le=65536)] = 1


class Values(Spec):
    """Where the values of one variable come from: files, or `values`, `even`, or a fact of the first file's `header`.

    Main arguments:
        units: of what is given, e.g. "ns"; converted to the variable's own.
        files: names in the folder of the recordings, stacked along `stack`; absent: the files of the command.
        axes: names of the axes of one file's array, in its order, e.g. ["row", "col"].
    Other arguments:
        array: of a file with several. stack: the axis along which files are stacked.
        values: a number, flag or list. even: even steps. header: name of a fact of the first file.
        scale, offset: value·scale + offset, before the units. channels: weights that sum the axis "channel".
        crop: {axis: [first, last + 1]}. roll: {axis: places to the right}, in a circle. invalid: values that are no data (NaN).
        tags: time tags to be counted.
    """

    example: ClassVar[str] = "docs/importing.md   (complete examples)"

    units: str = ""
    files: tuple[Name, ...] = ()
    axes: tuple[Name, ...] = ()
    array: str = ""
    stack: str = ""
    values: Any = None
    even: Even | None = None
    header: str = ""
    scale: float = 1.0
    offset: float = 0.0
    channels: tuple[float, ...] = ()
    crop: dict[str, tuple[int, int]] = Field(default_factory=dict)
    roll: dict[str, int] = Field(default_factory=dict)
    invalid: tuple[float, ...] = ()
    tags: Tags | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Values:
        given = [name for name in ("values", "even", "header", "tags") if getattr(self, name) not in (None, "")]
        if len(given) > 1 or (given and given != ["tags"] and self.files and given != ["header"]):
            raise ValueError(f"one source is given, not {given + (['files'] if self.files else [])}")
        return self


class Clean(Spec):
    """What is done to the frames before they are counts; then they are no longer single frames (`averaged`).

    Main arguments:
        median_px: rows and columns of the median that is taken off as background. pedestal_dn: added afterwards.
    """

    median_px: tuple[Annotated[int, Field(ge=1, le=4096)], Annotated[int, Field(ge=1, le=4096)]]
    pedestal_dn: float


class RigSource(Spec):
    """The rig as declared: of a scene (of the library, or a file), with values of a rig file over it; or written out.

    Main arguments:
        scene: its name or file. file: a rig file, as `calibrate` writes it. overrides: {path: value} of the scene.
        declared: the table of docs/declared-rig.md. unknown: its paths that nobody knows (null).
    Other arguments:
        register: what is found in the recording itself: a name of `estimators/calibration/registrations.py`.
        parameters: of that.
    """

    scene: str = ""
    file: str = ""
    overrides: dict[str, Any] = Field(default_factory=dict)
    declared: dict[str, Any] = Field(default_factory=dict)
    unknown: tuple[Name, ...] = ()
    register_: Annotated[str, Field(alias="register")] = ""
    parameters: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_rig(self) -> RigSource:
        if bool(self.scene) == bool(self.declared):
            raise ValueError("the rig is that of a scene, or a table `declared`: one of the two")
        if (self.file or self.overrides) and not self.scene:
            raise ValueError("`file` and `overrides` change the rig of a `scene`")
        return self


class Capture(Spec):
    """One of several captures: its own files and values of variables, by their names."""

    name: Name
    files: dict[str, tuple[Name, ...]] = Field(default_factory=dict)
    values: dict[str, Any] = Field(default_factory=dict)


class Mapping(Spec):
    """A mapping.

    Main arguments:
        modality: what the captures are of. data, coords, truth: variables of docs/conventions.md by name.
        truth_kind: where the truth comes from. rig: the instrument.
    Other arguments:
        capture: several captures; absent: one. clean: what is done to `counts`. averaged: counts are means of exposures.
        title, source, licence, caution: for people; they stand in the provenance.
        collection: names of mappings of one folder, each of which makes a store of its own; then nothing else is given.
    """

    example: ClassVar[str] = "docs/importing.md   (complete examples)"

    schema_version: Literal[1] = 1
    title: str = ""
    source: str = ""
    licence: str = ""
    caution: str = ""
    collection: tuple[Name, ...] = ()
    modality: str = ""
    averaged: bool = False
    truth_kind: TruthKind | None = None
    rig: RigSource | None = None
    data: dict[str, Values] = Field(default_factory=dict)
    coords: dict[str, Values] = Field(default_factory=dict)
    truth: dict[str, Values] = Field(default_factory=dict)
    clean: Clean | None = None
    capture: tuple[Capture, ...] = ()

    @model_validator(mode="after")
    def _whole(self) -> Mapping:
        single = {"modality": self.modality, "truth_kind": self.truth_kind, "rig": self.rig, "data": self.data}
        if self.collection:
            if any(single.values()):
                raise ValueError("a collection lists mappings, and is none itself")
        elif missing := [name for name, value in single.items() if not value]:
            raise ValueError(f"a mapping needs {', '.join(missing)}")
        return self


def load_mapping(source: str | Path) -> Mapping:
    """A mapping of the library, by its name, or a .toml file.

    Raises:
        InputError: no such mapping, an unknown key, a missing value, or a question mark that is not filled in.
    """
    path = find_spec_file(str(source), LIBRARY, kind="mapping", next_step="beambench import --scaffold FILE")
    data = read_spec_file(path)
    _refuse_marks(data, str(source))
    return validate_spec(Mapping, data, str(source))


def _refuse_marks(data: Any, where: str) -> None:
    """Refuse the question marks of a scaffold, all in one message."""
    found: list[str] = []
    todo: list[tuple[str, Any, int]] = [("", data, 0)]
    while todo:
        path, node, depth = todo.pop()
        if isinstance(node, dict) and depth < 50:
            todo += [(f"{path}.{key}".lstrip("."), value, depth + 1) for key, value in node.items()]
        elif isinstance(node, list) and depth < 50:
            todo += [(f"{path}.{index}", value, depth + 1) for index, value in enumerate(node)]
        elif node == "?":
            found.append(path)
    if found:
        first, *more = sorted(found)
        raise InputError(
            "The mapping has question marks that are not filled in.", where=f"{where}: {first}",
            value=", ".join([first, *more]), allowed="the value that the comment beside each one describes",
            next_step=f"open {where}, and write a value for each `?` (docs/importing.md)",
        )  # fmt: skip
