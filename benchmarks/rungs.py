"""Which rung each scene of a run was generated with, and what to type where a dearer one would matter."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import xarray as xr

from ..generator.effect import WORTH_A_WARNING
from .suites.suite import Cell

__all__ = ["Rungs", "rung_lines"]

#: An rtol below which `auto` leaves out no effect that is worth a warning.
_CLOSE_RTOL = 0.03


class Rungs:
    """The rungs of a run, gathered capture by capture.

    Main arguments:
        suite: as it is named on the command line. own: place of each entry of `scenes` that has a rung of its own, by scene.
    """

    def __init__(self, suite: str, own: Mapping[str, int]) -> None:
        self.suite, self._own = suite, own
        self._rows: dict[str, dict[str, Any]] = {}
        self._advice: tuple[float, str, str] = (0.0, "", "")

    def add(self, cell: Cell, capture: xr.Dataset) -> None:
        """Count the rung of a capture, and keep the largest effect that it leaves out."""
        told = json.loads(capture.attrs["fidelity"])
        rung, choice = str(told["rung"]), told.get("chosen")
        levels = (
            (axis, level) for axis, level in ((cell.stress, cell.level), (cell.stress2, cell.level2)) if level == level
        )
        name = ", ".join([cell.scene_name, *(f"{axis} {level:g}" for axis, level in levels)])
        row = self._rows.setdefault(name, {"scene": name, "fidelity": cell.fidelity, "rungs": {}})
        row["rungs"][rung] = row["rungs"].get(rung, 0) + 1
        if isinstance(choice, Mapping):
            error = (choice["predicted_error"] or {}).get(rung)
            row["predicted_error"] = max(row.get("predicted_error", 0.0), error or 0.0)
            row["limit"] = choice["limit"]
        for effect in told.get("effects", ()):
            size = effect["predicted_relative_size"] or 0.0
            if not effect["modelled"] and size > max(WORTH_A_WARNING, self._advice[0]):
                sentence = f"{effect['name']} changes the signal of {name} by {_told(size)}, and {rung} leaves it out"
                self._advice = (size, cell.scene_name, sentence)

    def rows(self) -> list[dict[str, Any]]:
        """For every scene (and stress): the `fidelity` asked for, the `rungs` with their captures, and for `auto` the greatest
        `predicted_error` of the chosen rung and the `limit` that it was compared with."""
        return list(self._rows.values())

    def advice(self) -> str:
        """One line that says what to type where a rung leaves out what is worth a warning, for the largest such effect; else ""."""
        size, scene, sentence = self._advice
        if not size:
            return ""
        chosen = any(
            row["fidelity"] == "auto" and row["scene"].partition(",")[0] == scene for row in self._rows.values()
        )
        path = f"scenes.{self._own[scene]}.fidelity" if scene in self._own else "fidelity"
        return f"{sentence}: beambench run {self.suite} --set {f'rtol={_CLOSE_RTOL}' if chosen else f'{path}=auto'}"


def rung_lines(rows: list[dict[str, Any]]) -> list[str]:
    """One line for each scene whose rung was chosen."""
    lines = []
    for row in rows:
        if row["fidelity"] != "auto":
            continue
        rungs, captures = row["rungs"], sum(row["rungs"].values())
        several = len(rungs) > 1
        told = ", ".join(f"{rung} ({n} of {captures} captures)" if several else rung for rung, n in rungs.items())
        errors = f": predicted error {row['predicted_error']:.2g}, limit {row['limit']:.2g}" if "limit" in row else ""
        lines.append(f"{row['scene']}: {told}{errors}")
    return lines


def _told(size: float) -> str:
    return f"{100 * size:.0f} %" if size < 2.0 else f"{size:.2g} times"
