"""Every rung on a family of scenes, and the choice between rungs: run, resume, tables, chart.

The measurement of one scene is in `measure.py`, the random scenes in `family.py`, and the comparison of `auto` with two
fixed policies in `rules.py`, whose rules were fixed before any measurement.

    python -m beambench.benchmarks.fidelity.run [--scenes 60] [--seed 1] [--out FOLDER] [--resume | --overwrite]
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError, reason
from ...scenes.json_keys import read_json
from ..folders.files import write_json, write_text
from ..folders.kinds import FIDELITY
from ..folders.workplace import output_folder, workplace
from ..scores.tables import to_csv
from .bench import Bench
from .chart import write_chart
from .family import family
from .measure import measure_scene
from .rules import POLICY_COLUMNS, decisions, policy_rows, summarise

__all__ = ["COLUMNS", "read_rows", "run_fidelity"]

COLUMNS = (
    "modality", "scene", "rung", "cpu_s", "rel_error", "lo", "hi", "task_error", "predicted_error", "chosen", "verdict",
    "rtol", "limit", "choice_cpu_s", "reference", "bias_seen",
)  # fmt: skip
_NUMBERS = ("cpu_s", "rel_error", "lo", "hi", "task_error", "predicted_error", "limit", "choice_cpu_s", "bias_seen")
#: Identity of a measurement, and the references of the scenes measured so far.
_STATE = "fidelity-scenes.json"


def run_fidelity(
    scenes: int = 60, seed: int = 1, out: str | Path | None = None, progress: Callable[[str], None] | None = None,
    *, resume: bool = False, overwrite: bool = False, bench: Bench | None = None,
) -> Path:  # fmt: skip
    """Measure a family of scenes; the folder, with fidelity.csv, policies.csv, fidelity.json and fidelity.svg.

    Tables are written after every scene, so that `resume` continues after the last complete one. With `overwrite` an
    earlier measurement in `out` is replaced when the new one is complete; until then the new one is in `out`/unfinished.
    `bench`: the scenes and their measurement; those of this folder by default.

    Raises:
        InputError: `resume` of a measurement of other scenes, or a folder that cannot be written.
    """
    folder = output_folder(out, "fidelity", resume=resume, overwrite=overwrite)

    def check(held: Path) -> None:
        _state(held, seed)

    with workplace(folder, FIDELITY, resume=resume, overwrite=overwrite, check=check) as work:
        _measure(work, scenes, seed, progress, resume, bench or Bench(family, measure_scene))
    return folder


def _state(folder: Path, seed: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows and references of the scenes measured in a folder."""
    if not (folder / _STATE).exists():
        return [], []
    try:
        state = read_json((folder / _STATE).read_text(encoding="utf-8"))
        drawn, told = int(state["seed"]), [dict(one) for one in state["scenes"]]
        done = {str(one["scene"]) for one in told}
        rows = [row for row in read_rows(folder / "fidelity.csv") if row["scene"] in done]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            "The measurement cannot be resumed: the record of its scenes cannot be read.",
            where=str(folder / _STATE),
            value=reason(error),
            next_step="add --overwrite to measure anew, or choose another --out",
        ) from error
    if drawn != seed:
        raise InputError(
            "The folder contains a measurement of other scenes.", where="--seed", value=seed, allowed=str(drawn)
        )
    return rows, told


def _measure(
    folder: Path, scenes: int, seed: int, progress: Callable[[str], None] | None, resume: bool, bench: Bench
) -> None:
    """Measure the scenes that are not yet in the folder, and write its files."""
    rows, told = _state(folder, seed) if resume else ([], [])
    done = {t["scene"] for t in told}
    say = progress or (lambda line: None)
    with tempfile.TemporaryDirectory() as meshes:
        drawn = bench.family(seed, scenes, Path(meshes))
        for number, scene in enumerate(drawn):
            if scene.name in done:
                continue
            begin = time.monotonic()
            found, references = bench.measure(scene, seed)
            rows += found
            told.append(references)
            write_text(folder / "fidelity.csv", to_csv(rows, COLUMNS))
            write_json(folder / _STATE, {"seed": seed, "scenes": told})
            say(_line(number + 1, len(drawn), found, references, time.monotonic() - begin))
    write_text(folder / "policies.csv", to_csv(policy_rows(decisions(rows)), POLICY_COLUMNS))
    write_json(folder / "fidelity.json", summarise(rows, told))
    write_chart(rows, folder / "fidelity.svg")


def _line(number: int, total: int, rows: list[dict[str, Any]], references: dict[str, Any], wall_s: float) -> str:
    """`3/60 scene: rung error … | limit>rung verdict …`, one line per scene."""
    errors: dict[str, float] = {}
    for row in rows:
        if row["rtol"] != "noise":
            errors[row["rung"]] = row["rel_error"]  # the strictest limit comes last
    shown = " ".join(f"{rung} {error:.2g}" for rung, error in errors.items())
    taken = " ".join(f"{r['rtol']}>{r['rung']} {r['verdict']}" for r in rows if r["chosen"])
    return f"{number}/{total} {rows[0]['scene']}: {shown} | {taken} | {references['references']} {wall_s:.0f} s"


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Rows of fidelity.csv with numbers as numbers."""
    with open(path, encoding="utf-8", newline="") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    for row in rows:
        # Tables of older versions do not state their reference: they could not see a systematic error of `full`.
        row.setdefault("reference", "own")
        row |= {name: float(row[name]) if row.get(name) else float("nan") for name in _NUMBERS}
        row["chosen"] = row["chosen"].lower() == "true"
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    """Command line of the measurement."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default=None)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--overwrite", action="store_true")
    options = parser.parse_args(argv)
    folder = run_fidelity(
        options.scenes, options.seed, options.out, lambda line: print(line, flush=True), resume=options.resume,
        overwrite=options.overwrite,
    )  # fmt: skip
    told = read_json((folder / "fidelity.json").read_text(encoding="utf-8"))
    print(json.dumps({k: v for k, v in told.items() if k != "references"}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
