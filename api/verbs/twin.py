"""`beambench twin`: whether a simulated sensor agrees with a real one, clause by clause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from ..benchmarks.twin.certificate import Certificate
    from ..benchmarks.twin.rig_file import TwinRig

__all__ = ["Twin", "twin"]


@dataclass(frozen=True)
class Twin:
    """A certificate, and the folder of its files."""

    found: Certificate
    out: Path


def twin(
    real: str | Path,
    *,
    rig: str | Path | None = None,
    scene: str | Path | None = None,
    index: int = 0,
    fidelity: Literal["direct", "scatter", "full", "geometric", "isolated", "coherent"] | None = None,
    draws: int = 40,
    estimator: Sequence[str] | None = None,
    tolerance: Sequence[str] | Mapping[str, float] | None = None,
    require: Sequence[str] | None = None,
    seed: int = 1,
    out: str | Path | None = None,
    overwrite: bool = False,
    command: Sequence[str] = (),
) -> Twin:
    """Compare a recording with its twin, and write a certificate.

    One half of the recording calibrates the twin, unless a rig file is given; many draws of it are compared with the other half.

    Main arguments:
        real: Store of the recording.
        rig: Rig file with standard errors, as `beambench calibrate` writes it; by default the first half calibrates.
        scene: What the rig looked at, name or file, whose rig is the start; by default one echo per pixel, fitted (gated only).
    Other arguments:
        index: Which capture of the store.
        fidelity: Rung that renders the scene, the cheapest by default: "scatter" or "full" with what the water scatters.
        draws: Simulated recordings; more narrow the intervals a little.
        estimator: Estimator whose place in the ranking is compared, repeatable; seven by default.
        tolerance: Tolerance of a clause in its unit, as NAME=VALUE, instead of its own.
        require: Clause that must be decided, repeatable: where noise hides it, nothing passes.
        seed: Random seed of the draws.
        out: Folder of certificate.html, clauses.csv and run.json; ./beambench-runs/twin-<name>-<time> by default.
        overwrite: Replace an earlier certificate in `out`.
        command: What was typed, for the page.

    Returns:
        `found`: the certificate, with `clauses` and `verdict`; and `out`.

    Raises:
        InputError: A recording that cannot be split, a rig or scene of another kind, or a modality without clauses.
    """
    from ..benchmarks.folders.kinds import slug
    from ..benchmarks.folders.workplace import output_folder, refuse_inputs
    from ..benchmarks.twin.clause import Ask
    from ..benchmarks.twin.run import certified
    from ..captures import open_captures

    capture = (store := open_captures(real))[_index(index, len(store))]
    folder = output_folder(out, f"twin-{slug(Path(real).stem)}", resume=False, overwrite=overwrite)
    refuse_inputs(folder, [real, *([rig] if rig is not None else [])])
    held = _rig(rig, str(capture.attrs["modality"]), Path(real).name)
    tolerances, ranked = _tolerances(tolerance), list(estimator or _RANKED)
    required = [require] if isinstance(require, str) else list(require or ())
    found = certified(capture, Ask(held, scene, fidelity, draws, seed, tuple(ranked)), tolerances, required)
    record = {
        "command": list(command), "index": index, "fidelity": fidelity, "draws": draws, "seed": seed, "rig": _text(rig),
        "scene": _text(scene), "estimators": ranked, "tolerance": tolerances, "require": required,
    }  # fmt: skip
    return _written(found, Path(real).name, folder, record, overwrite)


def _written(found: Certificate, recording: str, folder: Path, record: dict[str, object], overwrite: bool) -> Twin:
    from ..benchmarks.folders.kinds import TWIN
    from ..benchmarks.folders.workplace import workplace
    from ..benchmarks.twin.run import write_certificate

    with workplace(folder, TWIN, overwrite=overwrite) as work:
        write_certificate(found, recording, work, {"verb": TWIN.verb} | record)
    return Twin(found, folder)


#: Estimators whose ranking is compared by default.
_RANKED = (
    "poisson-ml", "matched-filter", "weighted-average[background=outside]", "parabola", "peak", "constant-fraction", "threshold",
)  # fmt: skip


def _text(path: str | Path | None) -> str | None:
    return None if path is None else str(path)


def _index(index: int, length: int) -> int:
    from ..scenes.errors import InputError

    if not 0 <= index < length:
        raise InputError("The store has no such capture.", where="--index", value=index, allowed=f"0 to {length - 1}")
    return index


def _rig(path: str | Path | None, kind: str, recording: str) -> TwinRig | None:
    from ..benchmarks.twin.rig_file import TwinRig
    from ..scenes.rig_files import read_rig_file

    if path is None:
        return None
    held = read_rig_file(path, kind)
    source = f"the rig file {Path(path).name}"
    named = [one.get("data") for one in held.calibration]
    if any(recording in data for data in named if isinstance(data, list | tuple)):
        source += (
            f" (calibrated on a recording of the same name, {recording}: if it is this one, the rig has also seen the half that is "
            "judged, which favours the twin)"
        )
    return TwinRig(held.overrides(), dict(held.uncertainty), source)


def _tolerances(given: Sequence[str] | Mapping[str, float] | None) -> dict[str, float]:
    from ..scenes.errors import InputError

    if given is None:
        return {}
    if isinstance(given, Mapping):
        return dict(given)
    found = {}
    for text in [given] if isinstance(given, str) else given:
        name, mark, value = str(text).partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            mark = ""
        if not mark:
            raise InputError(
                "This is no tolerance.",
                where="--tolerance",
                value=text,
                allowed="NAME=VALUE, a number in the clause's unit",
            )
    return found
