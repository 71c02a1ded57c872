"""The scenes of a data set, each drawn by its number: nothing depends on the order, the worker, or what else is drawn."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ..errors import InputError
from ..load import load_scene
from ..overrides import apply_overrides
from ..scene import Scene
from .content import at_path, scene_content
from .distributions import Expressed, Grid
from .expressions import Expression
from .spec import PARTS, Dataset, Rung, order_of

__all__ = ["Drawn", "Draws"]

#: The place of a stage of the generator's random numbers; its stages begin at 1.
_STAGE = 0


@dataclass(frozen=True)
class Drawn:
    """One draw: its number, the base scene's name, the values of all parameters, and {path: value} of the scene."""

    number: int
    base: str
    values: dict[str, Any]
    changes: dict[str, Any]


class Draws:
    """What a data set draws.

    Main arguments:
        data: the data set.
        scenes: its base scenes as plain data, by name, with names of files that lead to them.

    Parameter p of draw k is the quantile u = (b + ½)/2⁵³, b the first 53 bits of SeedSequence(seed, spawn_key=(k, 0, attempt,
    sha256(p))): a parameter that is added, or moved in the file, changes no other.
    """

    def __init__(self, data: Dataset, scenes: Mapping[str, dict[str, Any]]) -> None:
        self.data, self.scenes = data, dict(scenes)
        self._weights = np.cumsum([one.weight for one in data.scenes])
        self._order = order_of(data)
        self._expressions = {
            name: Expression(one.text, f"parameters.{name}.text")
            for name, one in data.parameters.items()
            if isinstance(one, Expressed)
        }
        self._roots = [np.linalg.cholesky(np.array(one.correlation)) for one in data.correlated]
        self._words = {name: _words(name) for name in (*data.parameters, "(scene)")}
        self._still: dict[str, str] = {}
        self._filled: dict[tuple[str, str, str], Any] = {}

    @classmethod
    def of(cls, resolved: Mapping[str, Any]) -> Draws:
        """The draws of what `resolved` gave. Raises InputError where it is not that."""
        from ..validate import validate_spec

        return cls(validate_spec(Dataset, resolved["dataset"], "data set"), resolved["scenes"])

    def resolved(self) -> dict[str, Any]:
        """All that a worker needs, as plain data."""
        return {"dataset": self.data.model_dump(mode="json"), "scenes": self.scenes}

    def drawn(self, number: int, attempt: int = 0) -> Drawn:
        """Draw `number`. Raises InputError where an expression has no value."""
        data, base = self.data, self.base(number)
        held = {name: one for name, one in data.parameters.items() if not one.scenes or base in one.scenes}
        quantiles = self._together(held, number, attempt)
        values: dict[str, Any] = self._grids(held, number)
        for name, one in held.items():
            if not isinstance(one, Expressed | Grid):
                values[name] = one.value(quantiles.get(name) or self._quantile(name, number, attempt))
        for name in self._order:
            if name in held:
                value = self._expressions[name].at(values)
                values[name] = round(value) if getattr(held[name], "whole", False) else value
        changes = {path: values[name] for name, one in held.items() for path in one.paths}
        return Drawn(number, base, {name: values[name] for name in held}, changes)

    def base(self, number: int) -> str:
        """Name of the base scene of draw `number`."""
        total = float(self._weights[-1])
        found = int(np.searchsorted(self._weights, self._quantile("(scene)", number, 0) * total, side="right"))
        return self.data.scenes[min(found, len(self._weights) - 1)].label

    def fidelity(self, base: str) -> Rung:
        """The rung of a base scene."""
        own = next(one.fidelity for one in self.data.scenes if one.label == base)
        return own or self.data.fidelity

    def scene(self, drawn: Drawn) -> Scene:
        """The scene of a draw. Raises InputError for a scene that is impossible."""
        return load_scene(self.scenes[drawn.base], drawn.changes)

    def possible(self, number: int) -> tuple[Drawn, Scene]:
        """The draw of a number, drawn again where the scene is impossible, at most `redraws` times, and its scene.

        Raises InputError: the last one is impossible too.
        """
        for attempt in range(self.data.redraws + 1):
            drawn = self.drawn(number, attempt)
            try:
                return drawn, self.scene(drawn)
            except InputError as error:
                if attempt < self.data.redraws:
                    continue
                told = ", ".join(f"{name} = {value!r}" for name, value in drawn.values.items())
                raise InputError(
                    f"Draw {number} of the data set is impossible: {error.what}", where=error.where, value=error.value,
                    allowed=error.allowed,
                    next_step=f"{error.next_step}; drawn: {told}; narrow the parameters, or state redraws".lstrip("; "),
                ) from error  # fmt: skip
        raise AssertionError

    def content(self, drawn: Drawn) -> str:
        """sha256 of the scene of a draw: its target and medium, by the content of their files, without names."""
        if not any(path.split(".")[0] in ("target", "medium") for path in drawn.changes):
            if drawn.base not in self._still:
                self._still[drawn.base] = scene_content(self.scenes[drawn.base], ("target", "medium"))
            return self._still[drawn.base]
        return scene_content(self._parts(drawn), ("target", "medium"))

    def part(self, drawn: Drawn) -> str:
        """The part of the split that a draw is in, by the hash of its group alone; "" without a split.

        u = sha256(seed, group)/2²⁵⁶ lies in one of the shares, so that a data set which grows keeps its parts.
        """
        split = self.data.split
        if split is None:
            return ""
        if "base" in split.by:
            group = self._base_content(drawn.base)
        elif split.by == ("target", "medium"):
            group = self.content(drawn)
        else:
            group = scene_content(self._parts(drawn), split.by)
        text = f"{self.data.seed} {group}".encode()
        u = int.from_bytes(hashlib.sha256(text).digest()[:8], "big") / 2**64
        ends = np.cumsum([getattr(split, name) for name in PARTS])
        given = [name for name in PARTS if getattr(split, name) > 0]
        return next((name for name, end in zip(PARTS, ends, strict=True) if u < end), given[-1])

    def _base_content(self, base: str) -> str:
        if base not in self._still:
            self._still[base] = scene_content(self.scenes[base], ("target", "medium"))
        return self._still[base]

    def _parts(self, drawn: Drawn) -> dict[str, Any]:
        """Target and medium of a draw, as plain data."""
        own = {key: self.scenes[drawn.base][key] for key in ("target", "medium")}
        changes = {
            path: self._whole(drawn, path, value) for path, value in drawn.changes.items() if path.split(".")[0] in own
        }
        return apply_overrides(own, changes)

    def _whole(self, drawn: Drawn, path: str, value: Any) -> Any:
        """A drawn table or list with the values that it leaves out, as a capture records it.

        Without them one scene would have two hashes, by whether a default is written down, and could be in two parts.
        """
        if not isinstance(value, Mapping | list | tuple):
            return value
        key = (drawn.base, path, json.dumps(value, sort_keys=True))
        if key not in self._filled:
            try:
                scene = load_scene(self.scenes[drawn.base], {path: value})
                self._filled[key] = at_path(scene.model_dump(mode="json"), path)
            except InputError:  # impossible without the other changes, or at all
                try:
                    return at_path(self.scene(drawn).model_dump(mode="json"), path)
                except InputError:
                    return value
        return self._filled[key]

    def _quantile(self, name: str, number: int, attempt: int) -> float:
        key = (number, _STAGE, attempt, *self._words[name])
        state = np.random.SeedSequence(self.data.seed, spawn_key=key).generate_state(1, np.uint64)
        return float(((int(state[0]) >> 11) + 0.5) * 2.0**-53)

    def _together(self, held: Mapping[str, Any], number: int, attempt: int) -> dict[str, float]:
        """Quantiles of the parameters that are drawn together: u = Φ(L z)."""
        if not self._roots:
            return {}
        from scipy.special import ndtr, ndtri

        found: dict[str, float] = {}
        for one, root in zip(self.data.correlated, self._roots, strict=True):
            if one.names[0] in held:
                z = ndtri([self._quantile(name, number, attempt) for name in one.names])
                u = np.clip(ndtr(root @ z), 2.0**-54, 1.0 - 2.0**-53)
                found |= dict(zip(one.names, map(float, u), strict=True))
        return found

    def _grids(self, held: Mapping[str, Any], number: int) -> dict[str, Any]:
        """The combination of the grids that is this number's turn."""
        grids = {name: one.values for name, one in held.items() if isinstance(one, Grid)}
        left = number % math.prod(map(len, grids.values()))
        found: dict[str, Any] = {}
        for name, values in reversed(grids.items()):
            left, place = divmod(left, len(values))
            found[name] = copy.deepcopy(values[place])
        return found


@cache
def _words(name: str) -> tuple[int, int]:
    digest = hashlib.sha256(name.encode()).digest()
    return int.from_bytes(digest[:4], "big"), int.from_bytes(digest[4:8], "big")
