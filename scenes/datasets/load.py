"""Load a data set from the library, a file or plain data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..load import anchored_overrides, load_scene
from ..overrides import apply_overrides
from ..spec_files import find_spec_file, read_spec_file
from ..validate import validate_spec
from .draws import Draws
from .spec import LIBRARY, Dataset, SceneChoice, list_datasets

__all__ = ["is_dataset", "load_dataset"]


def is_dataset(source: Any) -> bool:
    """Whether `source` is the name or the file of a data set."""
    if isinstance(source, Mapping):
        return "dataset" in source
    if not isinstance(source, str | Path):
        return False
    path = Path(source).expanduser()
    if path.suffix in {".toml", ".json"} and path.is_file():
        return "dataset" in read_spec_file(path)
    return str(source) in list_datasets()


def load_dataset(source: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | None = None) -> Draws:
    """The draws of a data set.

    Main arguments:
        source: a name in the library, a path to a .toml or .json file, or plain data.
        overrides: {path: value} of the data set, applied before validation.

    Scenes and the files that they and the parameters name lie in the folder of the data set's file, or in the library. Those
    of plain data are the user's own.

    Raises:
        InputError: unknown name, unreadable file, unknown key, missing or impossible value.
    """
    if isinstance(source, Mapping):
        data, where, folder = dict(source), "data set", None
    else:
        path = find_spec_file(
            str(source), LIBRARY, kind="data set", next_step="docs/data-sets.md   (a complete example)"
        )
        data, where, folder = read_spec_file(path), str(source), path.parent
    if overrides:
        data = apply_overrides(data, overrides)
    spec = validate_spec(Dataset, data, where)
    if folder is not None:
        spec = _anchored(spec, folder)
    return Draws(spec, {one.label: _base(one, folder, where) for one in spec.scenes})


def _base(one: SceneChoice, folder: Path | None, where: str) -> dict[str, Any]:
    source: str | Path = one.scene
    if folder is not None and one.scene.endswith((".toml", ".json")):
        source = (folder / one.scene).resolve()
        if not source.is_relative_to(folder.resolve()):
            raise InputError(
                "A scene of a data set's file should lie in its folder.", where=f"{where}: scenes", value=one.scene,
                allowed="a name of the library, or a file in the data set's folder",
            )  # fmt: skip
    scene = load_scene(source, one.overrides)
    held: dict[str, Any] = scene.model_dump(mode="json")
    return held


def _anchored(spec: Dataset, folder: Path) -> Dataset:
    """The data set with names of files that lead into its folder."""
    held = spec.model_dump(mode="json")
    for entry in held["scenes"]:
        entry["overrides"] = anchored_overrides(entry["overrides"], folder)
    for one in held["parameters"].values():
        if "values" in one:
            for path in one["paths"] or ["value"]:
                one["values"] = [anchored_overrides({path: value}, folder)[path] for value in one["values"]]
    return validate_spec(Dataset, held, str(folder))
