"""Which rung `auto` chose, and what it leaves out, for the terminal."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

__all__ = ["chosen_lines", "chosen_text"]

#: Captures of a store whose choice is told; equal ones are told once.
_MOST = 20


def chosen_lines(paths: Iterable[Path]) -> list[str]:
    """One line for each choice of the stores' captures."""
    from ..captures import open_captures

    lines = []
    for path in paths:
        captures = open_captures(path)
        lines += [chosen_text(json.loads(captures[i].attrs["fidelity"])) for i in range(min(len(captures), _MOST))]
    return [f"rung     {text}" for text in dict.fromkeys(lines) if text]


def chosen_text(told: Mapping[str, Any]) -> str:
    """The choice of a capture, from its attribute `fidelity`; "" where nothing was chosen."""
    chosen = told.get("chosen")
    if not isinstance(chosen, Mapping):
        return ""
    errors = ", ".join(f"{rung} {error:.2g}" for rung, error in chosen["predicted_error"].items() if error is not None)
    limit = float(chosen["limit"])
    left = [
        f"{effect['name']} ({effect['predicted_relative_size']:.2g})"
        for effect in told.get("effects", ())
        if not effect["modelled"] and (effect["predicted_relative_size"] or 0.0) > limit
    ]
    return (
        f"{told['rung']}: the cheapest with a predicted error below {limit:.3g} (predicted: {errors}); "
        f"effects above it that are left out: {', '.join(left) or 'none'}"
    )
