"""Check the estimators of a suite before anything runs: names and parameters are known, and no label occurs twice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError

__all__ = ["Chosen", "check_estimators", "missing_package"]


@dataclass(frozen=True)
class Chosen:
    """An estimator of a suite: its name, its parameters as `key=value,...` (keys sorted), and both as one label."""

    name: str
    params: str
    label: str


def missing_package(error: BaseException | None, home: str = "") -> str:
    """The missing package that made an import fail; "" if the import failed for another reason.

    A missing module of Beambench, of the estimator's own package (`home`: its "module:function"), or of an installed
    package is a bug in that package, not a missing extra.
    """
    from importlib.util import find_spec

    while error is not None and not isinstance(error, ModuleNotFoundError):
        error = error.__cause__
    top = (error.name or "").partition(".")[0] if error is not None else ""
    own = {"beambench", home.partition(":")[0].partition(".")[0]}
    return top if top and top not in own and find_spec(top) is None else ""


#: Parameters of built-in estimators that name a file; a relative path would fail, as each child starts in an empty folder.
_FILES = frozenset({"weights"})


def check_estimators(labels: Iterable[str], *, beside: str | Path | Mapping[str, Any] | None = None) -> list[Chosen]:
    """Parse and check labels, sort their keys, and make the paths of files in them absolute.

    Main arguments:
        labels: `name` or `name[key=value,...]`, each once.
    Other arguments:
        beside: the suite that lists the labels, as given: a relative path is resolved from the folder of its file first,
            then from the working folder.

    Parameters of built-in estimators are checked here. The parent holds the truth and never imports a plug-in: its child
    process checks its parameters, and an invalid one becomes the status of its rows.

    Raises:
        InputError: a name is unknown (with similar names), a label is malformed or occurs twice, a parameter is unknown or
            invalid, a file does not exist, or a single label was given in place of a list.
    """
    if isinstance(labels, str):
        raise InputError(
            "Estimators must be given as a list of labels.",
            where="estimators",
            value=labels,
            allowed="a list of name or name[key=value,...]",
            next_step=f"[{labels!r}]",
        )
    from ...estimators import BUILTIN
    from ...estimators.chain import is_built_in
    from ...estimators.labels import check_parameters, format_label, links_of, parse_label, split_label
    from ...estimators.registry import get_estimator, refuse_unknown

    chosen: list[Chosen] = []
    for label in labels:
        name, params = parse_label(label)
        links = links_of(name)
        refuse_unknown(links)
        if is_built_in(name):
            try:
                check_parameters(get_estimator(name).function, params, where=name)
            except InputError as error:
                if not missing_package(error, BUILTIN[links[-1]]):  # otherwise its child is skipped, with that reason
                    raise
            params = {key: _file(name, key, value, beside) if key in _FILES else value for key, value in params.items()}
        full = format_label(name, params)
        if any(other.label == full for other in chosen):
            raise InputError("An estimator is listed twice.", where="estimators", value=full, allowed="each label once")
        chosen.append(Chosen(*split_label(full), full))
    return chosen


def _file(name: str, key: str, value: Any, beside: str | Path | Mapping[str, Any] | None) -> Any:
    """The absolute path of the file that a parameter names; None (the built-in file) is returned unchanged."""
    if value is None:
        return None
    given = Path(str(value)).expanduser()
    folders = [Path.cwd()]
    if isinstance(beside, str | Path):
        folders.insert(0, Path(beside).expanduser().parent)
    for folder in folders:
        if (folder / given).is_file():
            path = str((folder / given).resolve())
            if not set(path) & set(",[]") and path == path.strip():
                return path
            raise InputError(
                "The file's path cannot stand in a label.", where=f"{name}[{key}]", value=path,
                allowed="no comma, no square bracket, no space at its end", next_step="copy the file to another folder",
            )  # fmt: skip
    raise InputError(
        "There is no such file.",
        where=f"{name}[{key}]",
        value=str(value),
        allowed="a file, by its absolute path or relative to "
        + " or ".join(dict.fromkeys(str(folder.resolve()) for folder in folders)),
        next_step="beambench estimators train --data FOLDER --out FILE" if key == "weights" else "check the path",
    )
