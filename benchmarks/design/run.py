"""Ask for a design, and write it down: a table, JSON, a picture, and the overrides that `generate --set` and scene files take."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ...scenes.errors import InputError
from ...scenes.records import object_at
from ...scenes.scene import Scene
from ..folders.files import write_json, write_text
from ..folders.progress import Progress, silent
from ..judges import JUDGES, judge_of
from ..scores.tables import to_csv
from .kind import Ask, Designs, Knob, Option
from .picture import save_design
from .result import Designed

__all__ = ["designed", "designs_of", "write_design"]

#: Delays are exchanged one after the other, over a grid: more of them than any camera takes would never end.
_MOST_SLICES = 512
_LEAST_BUDGET = 1e-9


def designs_of(scene: Scene) -> Designs:
    """The record of a scene's modality. Raises InputError for one that has no designs."""
    place = judge_of(scene.modality).design
    if not place:
        raise InputError(
            "Nothing is known that is chosen for such a scene.", where="design", value=scene.modality,
            allowed="scenes of " + ", ".join(name for name in JUDGES if judge_of(name).design),
            next_step="beambench scenes list",
        )  # fmt: skip
    found: Designs = object_at(place)
    return found


def designed(
    scene: Scene, *, budget: float = 1.0, margin_m: float | None = None, allow: Sequence[str] = (), fidelity: Any = None,
    seed: int = 1, model: str | None = None, progress: Progress = silent,
) -> Designed:  # fmt: skip
    """The design of least rms error among those that are not ambiguous.

    Main arguments:
        scene: to design for. budget: light in all, as a multiple of the scene's own.
    Other arguments:
        margin_m, fidelity, seed, model, progress: see `Ask`; the model by default the modality's first.
        allow: "NAME=VALUE,VALUE,…" for each setting to choose among other values.

    Raises InputError for a scene without designs, an unknown setting, or a number that cannot be used.
    """
    designs = designs_of(scene)
    knobs = tuple(designs.knobs(scene))
    _check(budget, margin_m)
    values = {knob.name: knob.values for knob in knobs} | _allowed(allow, knobs)
    if model is not None and model not in designs.models:
        raise InputError(
            "No estimator of such a model is known here.", where="estimator_model", value=model,
            allowed=" or ".join(designs.models),
        )  # fmt: skip
    ask = Ask(budget, margin_m, values, fidelity, seed, model or designs.models[0], progress)
    options, curve = designs.options(scene, ask)
    best = min((one for one in options if one.allowed), key=lambda one: one.error, default=options[0])
    factor, unit = designs.shown
    return Designed(
        scene.name, designs.quantity, unit, factor, tuple(options), best, designs.guard, curve, knobs, ask.model,
    )  # fmt: skip


def _check(budget: float, margin_m: float | None) -> None:
    for name, value, least in (
        ("budget", budget, _LEAST_BUDGET),
        ("margin_m", 0.0 if margin_m is None else margin_m, 0.0),
    ):
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < math.inf:
            raise InputError(
                "A number of the design is out of range.", where=name, value=value,
                allowed=f"{least:g} or more, finite",
            )  # fmt: skip


def _allowed(allow: Sequence[str], knobs: Sequence[Knob]) -> dict[str, tuple[float, ...]]:
    """Values by the name of a setting."""
    found: dict[str, tuple[float, ...]] = {}
    known = {knob.name: knob for knob in knobs}
    for text in [allow] if isinstance(allow, str) else allow:
        name, mark, rest = str(text).partition("=")
        if not mark or name not in known:
            raise InputError(
                "There is no such setting to choose.", where="allow", value=text,
                allowed=" or ".join(f"{knob.name}=VALUE,… [{knob.unit}]" for knob in knobs),
            )  # fmt: skip
        try:
            values = tuple(sorted({float(one) for one in rest.split(",")}))
        except ValueError:
            values = ()
        counts = known[name].unit == "1"
        whole = not counts or all(2 <= one <= _MOST_SLICES and one == int(one) for one in values)
        length = known[name].unit in ("m", "s")  # an angle may be 0 or negative
        if not values or not all(map(math.isfinite, values)) or not whole or (length and values[0] <= 0):
            raise InputError(
                "The values of a setting are numbers.", where=f"allow: {name}", value=rest,
                allowed=f"whole numbers from 2 to {_MOST_SLICES}" if counts
                else f"numbers {'above 0 ' if length else ''}in {known[name].unit}",
            )  # fmt: skip
        found[name] = values
    return found


def write_design(found: Designed, source: str, out: Path, record: Mapping[str, Any]) -> None:
    """Write design.csv, run.json, design.png and overrides.json into a folder.

    overrides.json holds {path: value}; `set.txt` the same as options of `beambench generate`. Raises InputError.
    """
    rows = [
        {
            "design": one.name, **{knob.name: one.settings.get(knob.name, math.nan) for knob in found.knobs},
            f"bound_{found.unit}": found.factor * one.bound,
            f"bias_{found.unit}": found.factor * one.bias, "gain": found.own.error / one.error, "guard": one.guard,
            "chosen": one is found.best, "why_not": one.why,
        }
        for one in found.options
    ]  # fmt: skip
    write_text(out / "design.csv", to_csv(rows, list(rows[0])))
    write_json(
        out / "run.json",
        {
            **record, "scene": found.scene, "quantity": found.quantity, "unit": found.unit, "gain": found.gain,
            "estimator_model": found.model,
            "best": _plain(found, found.best), "options": [_plain(found, one) for one in found.options],
        },
    )  # fmt: skip
    write_json(out / "overrides.json", dict(found.best.overrides))
    options = " ".join(f"--set '{path}={json.dumps(value)}'" for path, value in found.best.overrides.items())
    write_text(out / "set.txt", f"beambench generate {source} {options}\n")
    save_design(found, out / "design.png")


def _plain(found: Designed, option: Option) -> dict[str, Any]:
    data = asdict(option)
    data["bound"] = found.factor * option.bound if math.isfinite(option.bound) else None
    data["bias"] = found.factor * option.bias if math.isfinite(option.bias) else None
    data["guard"] = option.guard if math.isfinite(option.guard) else None
    return data
