"""The output of each verb: the mark by which its folder is recognised, and the files that the verb owns."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...scenes.json_keys import read_json

__all__ = [
    "BREAK",
    "CARD",
    "DESIGN",
    "ESTIMATE",
    "FIDELITY",
    "REPRODUCE",
    "RUN",
    "SCORE",
    "SWEEP",
    "TWIN",
    "Kind",
    "is_finished",
    "slug",
    "verb_in",
]


@dataclass(frozen=True)
class Kind:
    """A verb's output.

    Main arguments:
        verb: its name. owned: patterns of the files that it writes, relative to the folder; no others are ever replaced.
        kept: whether a folder contains finished work, which is then kept when the verb is interrupted.
    Other arguments:
        resumes: the verb can resume it. whole: the result appears only when it is complete.
        note: how to use work that is kept but cannot be resumed.
        named: further files that the verb owns in a folder, listed in its mark.
    """

    verb: str
    owned: tuple[str, ...]
    kept: Callable[[Path], bool]
    resumes: bool = False
    whole: bool = False
    note: str = ""
    named: Callable[[Path], list[str]] | None = None

    def files(self, folder: Path) -> list[Path]:
        """The verb's own files and stores in the folder, also those that a crash left half written.

        Links are not followed: files elsewhere are never touched.
        """
        names = (*self.owned, *(self.named(folder) if self.named is not None else ()))
        patterns = [pattern for name in names for pattern in (name, f"{name}.partial")]
        found = {path: None for pattern in patterns for path in sorted(folder.glob(pattern))}
        return [path for path in found if path.parent == folder or not path.parent.is_symlink()]


def slug(name: str) -> str:
    """A name as a part of a file name: letters, digits, dot, dash and underscore."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.") or "run"


def _read(path: Path) -> dict[str, Any]:
    """The JSON object in a file (in the first line of a .jsonl), {} where there is none."""
    try:
        with open(path, encoding="utf-8") as file:
            value = read_json(file.readline() if path.suffix == ".jsonl" else file.read())
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def _begins(path: Path, text: str) -> bool:
    try:
        with open(path, "rb") as file:
            return file.read(len(text)) == text.encode()
    except OSError:
        return False


def verb_in(folder: Path) -> str:
    """The verb whose output is in a folder, "" if the folder has no mark of Beambench."""
    run, journal = _read(folder / "run.json"), _read(folder / "journal.jsonl")
    for record in (run, journal):
        if isinstance(record.get("verb"), str):
            return str(record["verb"])
    if "suite_hash" in journal or {"hash", "tables_version"} <= set(run):
        return "sweep" if "budget" in run or (folder / "breakdown.csv").exists() else "run"
    if {"neighbours", "judged"} <= set(run) or _begins(folder / "search.csv", "scene,levels,badness\n"):
        return "break"
    if isinstance(_read(folder / "estimates.json").get("estimators"), list):
        return "estimate"
    if _begins(folder / "scores.csv", "suite,scene,stress,level,"):
        return "score"
    if _begins(folder / "reproduction.csv", "document,item,quantity,"):
        return "reproduce"
    if _begins(folder / "fidelity.csv", "modality,scene,rung,"):
        return "fidelity"
    return ""


def is_finished(folder: Path) -> bool:
    """Whether a run or sweep in a folder came to its end: its run.json says when, and no work was recorded after it."""
    try:
        later = (folder / "journal.jsonl").stat().st_mtime > (folder / "run.json").stat().st_mtime
    except OSError:
        later = False
    return isinstance(_read(folder / "run.json").get("finished"), str) and not later


def _files_of_labels(folder: Path) -> list[str]:
    labels = _read(folder / "estimates.json").get("estimators")
    return [f"{slug(label)}.h5" for label in labels if isinstance(label, str)] if isinstance(labels, list) else []


def _measured(folder: Path) -> bool:
    """Whether a journal has more than its header, or some captures are complete."""
    return _lines(folder / "journal.jsonl") > 1 or any(folder.glob("captures/*.zarr"))


def _lines(path: Path) -> int:
    try:
        with open(path, "rb") as file:
            return sum(1 for _ in file)
    except OSError:
        return 0


def _never(folder: Path) -> bool:
    return False


_TABLES = (
    "scores.csv", "scores.parquet", "accuracy.csv", "summary.csv", "ranking.csv", "pairs.csv", "profiles.csv",
    "report.html", "report.csv", "report.md", "report.tex", "report.bib", "speed-accuracy.png", "speed-accuracy.svg",
)  # fmt: skip
_OF_A_SUITE = (
    *_TABLES, "run.json", "journal.jsonl", "costs.csv", "inputs.csv", "resolution.csv", "errors_by_tile.npz", "captures/*.zarr",
    "pictures/*__*.npz", "breakdown.csv", "failure_map.csv", "maps/*.svg", "maps/*.png",
)  # fmt: skip

RUN = Kind("run", _OF_A_SUITE, _measured, resumes=True)
SWEEP = Kind("sweep", _OF_A_SUITE, _measured, resumes=True)
ESTIMATE = Kind(
    "estimate", ("estimates.json",), lambda folder: any(folder.glob("*.h5")), resumes=True, named=_files_of_labels
)
SCORE = Kind("score", (*_TABLES, "run.json"), _never, whole=True)
REPRODUCE = Kind(
    "reproduce",
    ("reproduction.csv", "reproduction.parquet", "reproduction.html", "run.json", "pictures/*.png"),
    _never,
    whole=True,
)
BREAK = Kind(
    "break",
    ("break-*.toml", "search.csv", "run.json"),
    lambda folder: _lines(folder / "search.csv") > 1,
    note="search.csv lists the candidates judged so far",
)
DESIGN = Kind("design", ("design.csv", "run.json", "design.png", "overrides.json", "set.txt"), _never, whole=True)
CARD = Kind("data card", ("card.md", "card.html", "run.json", "pictures/*.svg", "pictures/*.png"), _never, whole=True)
FIDELITY = Kind(
    "fidelity",
    ("fidelity.csv", "policies.csv", "fidelity.json", "fidelity.svg", "fidelity-scenes.json"),
    lambda folder: (folder / "fidelity.csv").is_file(),
    resumes=True,
)
TWIN = Kind("twin", ("certificate.html", "clauses.csv", "run.json"), _never, whole=True)
