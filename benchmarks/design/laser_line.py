"""Design of a laser line: distance of the laser from the camera, and the angle of its sheet.

Every design is generated with the target as the scene has it, and nearer and farther by `margin`; what is bounded is the point, by
`bounds.laser_line`. A longer baseline tells more of the range, and moves the line farther over the image: the guard is the share of
the scene's rows that show the line, of what its own design shows, in the worst of the three places.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from ...scenes.load import load_scene
from ...scenes.rigs.laser_line import laser_line_rig
from ...scenes.scene import Scene
from ..bounds.laser_line import laser_line_bounds
from ..suites.stress import axis_overrides
from .kind import Ask, Curve, Designs, Knob, Option, Steps

__all__ = ["DESIGNS"]

#: Multiples of the baseline, and turns of the sheet [degree], from which a design is chosen by default.
_LONGER, _TURNED = (0.5, 1.0, 1.5, 2.0), (-6.0, -3.0, 0.0, 3.0, 6.0)
#: Share of the rows of the own design that must show the line, and the margin as a share of the distance.
_SEEN, _MARGIN = 0.99, 0.1


def _knobs(scene: Scene) -> Sequence[Knob]:
    laser = laser_line_rig(scene).laser
    length, angle = math.hypot(*laser.position_m), laser.rotation_deg[1]
    return (
        Knob("baseline", "m", "distance of the laser from the camera", tuple(length * one for one in _LONGER)),
        Knob("angle", "deg", "turn of the sheet about the vertical", tuple(angle + one for one in _TURNED)),
    )


def _placed(scene: Scene, baseline_m: float, angle_deg: float) -> dict[str, Any]:
    """Overrides: the laser in the same direction from the camera, at another distance and angle."""
    laser = laser_line_rig(scene).laser
    factor = baseline_m / math.hypot(*laser.position_m)
    first, _, last = laser.rotation_deg
    return {
        "rig.laser.position_m": [one * factor for one in laser.position_m],
        "rig.laser.rotation_deg": [first, angle_deg, last],
    }


def _seen(scene: Scene, ask: Ask, margin_m: float, overrides: dict[str, Any]) -> tuple[float, int]:
    """(rms bound of the points [m] of the target where it is, least number of rows with a line of the three places)."""
    from ...generator.generate import generate

    base = load_scene(scene, overrides)
    rows, bound = [], math.inf
    for moved in (0.0, -margin_m, margin_m):
        placed = base if moved == 0.0 else load_scene(base, axis_overrides(base, "distance", moved))
        capture = generate(placed, seed=ask.seed, fidelity=ask.fidelity, rtol=0.01)
        if moved == 0.0:
            sigma = laser_line_bounds(capture)["point"].sigma
            own = np.sqrt((sigma[np.isfinite(sigma).all(axis=-1)] ** 2).sum(axis=-1))
            bound = float(np.sqrt((own**2).mean())) if own.size else math.inf
        column = np.asarray(capture["truth_column"].values, np.float64)
        # A line at the edge of the image is not found.
        inside = (column > 3.0) & (column < capture.sizes["col"] - 4.0)
        rows.append(int(inside.any(axis=-1).sum()))
    return bound, min(rows)


def _options(scene: Scene, ask: Ask) -> tuple[list[Option], Curve]:
    light = load_scene(scene, axis_overrides(scene, "photons", ask.budget)) if ask.budget != 1.0 else scene
    laser = laser_line_rig(scene).laser
    length, angle = math.hypot(*laser.position_m), laser.rotation_deg[1]
    margin = ask.margin_m
    if margin is None:
        margin = _MARGIN * min(item.shape.center_m[2] for item in scene.target)
    bound, rows = _seen(light, ask, margin, {})
    found = [Option("the scene's own", {"baseline": length, "angle": angle}, {}, bound, 1.0)]
    asked = list(itertools.product(ask.values["baseline"], ask.values["angle"]))
    step = Steps(ask.progress, len(asked))
    for baseline, turn in asked:
        overrides = _placed(scene, baseline, turn)
        settings, name = {"baseline": baseline, "angle": turn}, f"{1e3 * baseline:.4g} mm, {turn:.3g} deg"
        step(name)
        try:
            bound, own = _seen(light, ask, margin, overrides)
        except InputError as error:
            found.append(Option(name, settings, overrides, math.inf, 0.0, error.what))
            continue
        share = own / max(rows, 1)
        found.append(
            Option(name, settings, overrides, bound, share, "" if share >= _SEEN else "the line leaves the image")
        )
    return found, _curve(found)


def _curve(found: Sequence[Option]) -> Curve:
    """The least bound of an allowed angle against the baseline."""
    best: dict[float, float] = {}
    for option in found[1:]:
        if option.allowed:
            at = option.settings["baseline"]
            best[at] = min(best.get(at, math.inf), option.bound)
    x = np.array(sorted(best))
    return Curve(1e3 * x, np.array([1e3 * best[at] for at in x]), "baseline [mm]", "rms bound, best angle [mm]")


DESIGNS = Designs(
    knobs=_knobs, options=_options, quantity="point", shown=(1e3, "mm"),
    guard="rows that show the line at all three distances, over those of the scene's own design: .99 or more",
)  # fmt: skip
