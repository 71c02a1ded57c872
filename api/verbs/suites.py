"""`beambench suites list`, `beambench suites show` and `beambench suites new`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["suites_list", "suites_new", "suites_show"]

_HEAD = """A suite: scenes, seeds, conditions and estimators. Run it: beambench run {file}
Every key is in the documentation, "Suite files". Scenes: beambench scenes list. Estimators: beambench estimators list."""


def suites_list() -> list[dict[str, Any]]:
    """List the suites that ship with Beambench.

    Returns:
        One record per suite: name, version, title, number of scenes, estimators and test seeds, conditions, stresses, and
        the suites that it joins.
    """
    from ..benchmarks.suites.suite import SUITES, list_suites
    from ..scenes.spec_files import read_spec_file

    listed = []
    for name in list_suites():
        data = read_spec_file(SUITES / f"{name}.toml")
        listed.append({
            "name": name, "version": data.get("version", 1), "title": data.get("title", ""),
            "scenes": len(data.get("scenes", ())), "estimators": len(data.get("estimators", ())),
            "seeds": len(data.get("seeds", {}).get("test", ())), "conditions": list(data.get("conditions", ())),
            "stresses": [one["axis"] for one in data.get("stresses", ())], "parts": list(data.get("parts", ())),
        })  # fmt: skip
    return listed


def suites_show(suite: str | Path | Mapping[str, Any], *, overrides: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Show a suite: its file with its comments, and how many captures and estimates a run makes.

    Main arguments:
        suite: Name of a suite that ships with Beambench, or a .toml or .json file; in Python also a suite as data.
        overrides: {path: value}, applied before validation; a path of the suite, or one of every scene.

    Returns:
        `suite` (as validated, parts joined), `text` (of its file; empty for data), `captures` and `estimates` of a
        run of the test seeds, `scenes` ({name in the suite: title}).

    Raises:
        InputError: No such suite, an unknown key, or a missing or impossible value.
    """
    from ..benchmarks.suites.suite import SUITES, cells_of, load_suite
    from ..scenes.spec_files import find_spec_file

    loaded = load_suite(suite, overrides)
    text = ""
    if not isinstance(suite, Mapping) and not overrides:
        path = find_spec_file(str(suite), SUITES, kind="suite", next_step="beambench suites list")
        text = path.read_text(encoding="utf-8-sig")
    cells = cells_of(loaded, "test")
    estimates = sum(
        len(loaded.conditions(cell.scene_name))
        * sum(loaded.reads(label, cell.scene_name) for label in loaded.suite.estimators)
        for cell in cells
    )
    return {
        "suite": loaded.suite.model_dump(mode="json"), "text": text, "captures": len(cells), "estimates": estimates,
        "scenes": {name: scene.title for name, scene in loaded.scenes},
    }  # fmt: skip


def suites_new(name: str, *, like: str = "quickstart", out: str | Path | None = None, overwrite: bool = False) -> Path:
    """Write the file of a suite of your own, begun from one that ships, with its comments.

    Main arguments:
        name: Name of the new suite.
    Other arguments:
        like: Suite that it begins from.
        out: The file; ./<name>.toml by default.
        overwrite: Replace an existing file.

    Returns:
        The path of the file.

    Raises:
        InputError: A bad name, no such suite, or a file that exists.
    """
    from ..benchmarks.suites.suite import SUITES, list_suites
    from .new_file import write_new

    return write_new(name, "suite", "suite", SUITES, list_suites(), like, out, overwrite, _HEAD)
