"""Chains: estimators of successive stages under one label, `line-erf+triangulate-refractive`, which reads captures.

Each link gets what its stage takes, in that order: the capture, the result of the earlier link that gives the quantity it names, or
the declared rig, or the capture's coordinates. The result is that of the last link. A parameter belongs to the one link that
has it.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from ..captures.quantities import CAPTURE, COORDINATES, Stage
from ..scenes.errors import InputError
from .builtin import BUILTIN
from .labels import LINK, links_of
from .result import check_result
from .rig import read_rig

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["chained_function", "check_chain", "is_built_in"]


#: What every link may take beside the results of earlier ones.
_ALWAYS = frozenset({"rig", COORDINATES})


class Link(Protocol):
    """What a chain needs to know of an estimator."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def stage(self) -> Stage:
        """What it takes and gives."""
        ...

    @property
    def function(self) -> Callable[..., xr.Dataset]:
        """The algorithm."""
        ...


def is_built_in(name: str) -> bool:
    """Whether an estimator, or every link of a chain, ships with Beambench."""
    return all(link in BUILTIN for link in links_of(name))


def check_chain(links: Sequence[Link]) -> None:
    """Refuse a chain whose first link reads no capture, or of which a link takes what no earlier one gives. Raises InputError."""
    label = LINK.join(link.name for link in links)
    given: set[str] = {CAPTURE}
    for number, link in enumerate(links):
        missing = [name for name in link.stage.takes if name not in given | _ALWAYS]
        if missing or (number > 0 and link.stage.reads_captures) or link.stage.modality != links[0].stage.modality:
            raise InputError(
                f"The link {link.name} of a chain does not read what the links before it give.", where=label,
                value=", ".join(link.stage.takes), allowed=", ".join(sorted(given | _ALWAYS)),
                next_step="begin with an estimator that reads captures, and go on with those of the next stages",
            )  # fmt: skip
        given |= {quantity.name for quantity in link.stage.gives}


def chained_function(links: Sequence[Link]) -> Callable[..., xr.Dataset]:
    """The links as one function of a capture, with the parameters of all; those that several links have keep their defaults."""
    owner: dict[str, list[int]] = {}
    parameters: dict[str, inspect.Parameter] = {}
    hints: dict[str, Any] = {}
    for number, link in enumerate(links):
        known = typing.get_type_hints(link.function)
        for key, parameter in inspect.signature(link.function).parameters.items():
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY:
                owner.setdefault(key, []).append(number)
                parameters[key], hints[key] = parameter, known.get(key, Any)
    own = {key: numbers[0] for key, numbers in owner.items() if len(numbers) == 1}

    def chained(capture: xr.Dataset, **params: Any) -> xr.Dataset:
        results: dict[str, xr.Dataset] = {}
        result = capture
        for number, link in enumerate(links):
            mine = {key: value for key, value in params.items() if own[key] == number}
            result = link.function(*_inputs(link.stage, capture, results), **mine)
            if number < len(links) - 1:
                result = check_result(result, capture, link.name, link.stage)
            results |= {quantity.name: result for quantity in link.stage.gives}
        return result

    chained.__doc__ = " then ".join((inspect.getdoc(link.function) or "").partition("\n")[0] for link in links)
    chained.__annotations__ = {key: hints[key] for key in own}
    first = inspect.Parameter("capture", inspect.Parameter.POSITIONAL_ONLY)
    chained.__signature__ = inspect.Signature([first, *(parameters[key] for key in own)])  # type: ignore[attr-defined]
    return chained


def _inputs(stage: Stage, capture: xr.Dataset, results: dict[str, xr.Dataset]) -> list[Any]:
    """What a link's function takes, in order."""
    made: list[Any] = []
    for name in stage.takes:
        if name == CAPTURE:
            made.append(capture)
        elif name == "rig":
            made.append(read_rig(capture))
        elif name == COORDINATES:
            made.append(capture.coords.to_dataset())
        else:
            made.append(results[name])
    return made
