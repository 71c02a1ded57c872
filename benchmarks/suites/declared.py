"""The condition "declared": the scene itself says that its rig is declared otherwise than it is (table `[declared]`).

What a suite calls "matched" leaves the declared rig as the capture holds it. It is exact only where the scene declares nothing;
otherwise tables name the condition "declared", as errors of such a rig are no errors of the method alone. A stress of the
declared rig ("wrong-t0") is no condition: its column says it, and levels of one stress stay in one group.
"""

from __future__ import annotations

import math
from typing import Any

from ...scenes.scene import Scene

__all__ = ["DECLARED", "MATCHED", "declared_note", "differences", "told_condition"]

MATCHED, DECLARED = "matched", "declared"


def differences(scene: Scene) -> list[str]:
    """Values that a scene declares otherwise than they are: "camera.focal_length_m 0.0081, truly 0.008"."""
    true = {"medium": scene.medium.model_dump(mode="json"), **scene.rig.model_dump(mode="json")}
    found = []
    for path, value in scene.declared.items():
        truth: Any = true
        for part in path.split("."):
            truth = truth.get(part) if isinstance(truth, dict) else None
        if not _same(value, truth):
            found.append(f"{path} {value}, truly {'not given as one value' if truth is None else truth}")
    return found


def told_condition(condition: str, scene: Scene) -> str:
    """The name of a condition in tables: "declared" in place of "matched" where the scene's declared rig is not the true one."""
    return DECLARED if condition == MATCHED and differences(scene) else condition


def declared_note(scene: Scene) -> str:
    """A sentence of what a scene declares wrongly; "" where that is nothing."""
    found = differences(scene)
    return (
        f'{scene.name} is scored under the condition "{DECLARED}": its rig is declared with {"; ".join(found)}'
        if found
        else ""
    )


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=1e-12)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)
