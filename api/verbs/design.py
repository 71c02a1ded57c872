"""`beambench design`: the settings of a rig that make the bound of a scene's estimates least for its light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from ..benchmarks.design.result import Designed
    from ..benchmarks.folders.progress import Progress
    from ..scenes.scene import Scene

__all__ = ["Design", "design"]


@dataclass(frozen=True)
class Design:
    """A design, and the folder of its files."""

    found: Designed
    out: Path


def design(
    scene: str | Path | Mapping[str, Any] | Scene, *,
    overrides: Mapping[str, Any] | None = None, budget: float = 1.0, margin_m: float | None = None,
    allow: Sequence[str] | None = None,
    fidelity: Literal["direct", "scatter", "full", "geometric", "isolated", "coherent"] | None = None,
    estimator_model: Literal["direct", "exact"] | None = None, seed: int = 1, out: str | Path | None = None,
    overwrite: bool = False, progress: Progress | None = None, command: Sequence[str] = (),
) -> Design:  # fmt: skip
    """Choose the settings of a scene's rig whose error, by the bound and by bias, is least for its light.

    A stack of gated images: number and places of the delays and the width of the gate, for equally many pulses in all. A laser
    line: its distance from the camera and the angle of the sheet. A wavefront sensor: pitch and focal length of the lenslets. The
    bound is the root mean square of the Fisher information's over the elements of the scene; designs under which a range, row or
    spot could be taken for another are refused.

    Main arguments:
        scene: Name of a scene, or a .toml or .json file; in Python also a scene as data.
        overrides: {path: value}, applied before validation.
    Other arguments:
        budget: Light in all, as a multiple of the scene's own: pulses of all slices, power of a laser, energy of a pulse.
        margin_m: By how much the target may be nearer or farther than the scene says, m; by default half of the width of the
            response (gated), or a tenth of the distance (laser line).
        allow: Values to choose from, NAME=VALUE,VALUE: slices, gate-width [s]; baseline [m], angle [deg]; pitch, focal-length [m].
        fidelity: Rung that gives the light of the scene, the cheapest by default: with "scatter" and "full" what water and
            other surfaces add is in the bound.
        estimator_model: What the estimator knows of light that is not direct: "direct", the default for gated images, takes it for
            direct light, as all estimators here do, and its bias counts; "exact" knows it, and reaches the bound.
        seed: Random seed of the captures that give the light, and of the choice of elements.
        out: Folder of design.csv, run.json, design.png, overrides.json, set.txt; ./beambench-runs/design-<scene>-<time> by default.
        overwrite: Replace an earlier design in `out`.
        progress: Receives every step.
        command: What was typed, for run.json.

    Returns:
        `found`: the designs, with `own`, `best`, `gain` (their ratio) and `options`; and `out`.

    Raises:
        InputError: Bad input, or a scene without designs.
    """
    from ..benchmarks.design.run import designed, write_design
    from ..benchmarks.folders.kinds import DESIGN, slug
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..scenes.load import load_scene

    loaded = load_scene(scene, overrides)
    folder = output_folder(out, f"design-{slug(loaded.name)}", resume=False, overwrite=overwrite)
    found = designed(
        loaded, budget=budget, margin_m=margin_m, allow=tuple(allow or ()), fidelity=fidelity, seed=seed, model=estimator_model,
        progress=progress or silent,
    )  # fmt: skip
    record = {
        "verb": DESIGN.verb, "command": list(command), "overrides": dict(overrides or {}), "budget": budget,
        "margin_m": margin_m, "allow": list(allow or ()), "fidelity": fidelity, "seed": seed,
        "estimator_model": found.model,
    }  # fmt: skip
    with workplace(folder, DESIGN, overwrite=overwrite) as work:
        write_design(found, str(scene) if isinstance(scene, str | Path) else loaded.name, work, record)
    return Design(found, folder)
