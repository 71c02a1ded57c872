"""The modalities: which floors have a record of each, and why a record is not there yet."""

from __future__ import annotations

from .finding import Finding

__all__ = ["NOT_YET", "floors", "modalities"]

#: (floor, modality) -> why the floor has no record of it yet. All other pairs have one: a test enumerates them.
NOT_YET: dict[tuple[str, str], str] = {}


def floors() -> dict[str, set[str]]:
    """The modalities that have a record on each floor, as the floors' tables list them."""
    from ..benchmarks.judges import JUDGES
    from ..captures.layouts import LAYOUTS
    from ..estimators.listing import modalities_read
    from ..generator.models import MODELS
    from ..scenes.rigs import RIGS

    return {
        "scenes": set(RIGS),
        "captures": set(LAYOUTS),
        "generator": set(MODELS),
        "estimators": modalities_read(),
        "benchmarks": set(JUDGES),
    }


def modalities() -> list[Finding]:
    """One record per modality: the floors that have it, and the reasons of those that do not."""
    there = floors()
    found = []
    for name in sorted(set().union(*there.values())):
        missing = [floor for floor, names in there.items() if name not in names]
        if not missing:
            found.append(Finding("modalities", name, "ok", "every floor"))
            continue
        reasons = "; ".join(
            f"{floor}: {NOT_YET.get((floor, name), 'no record, and no reason given')}" for floor in missing
        )
        state = "missing" if all((floor, name) in NOT_YET for floor in missing) else "broken"
        have = ", ".join(floor for floor in there if floor not in missing)
        found.append(Finding("modalities", name, state, f"{have} only", reasons))
    return found
