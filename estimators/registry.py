"""The registry: mark, find and run estimators. Built-in ones are listed in `builtin.py`; other packages register theirs under
the entry-point group ``beambench.estimators`` (name -> "module:function")."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint
from typing import Any, TypeVar, cast

import xarray as xr

from ..captures.layouts import stage_of
from ..captures.quantities import Stage
from ..scenes.errors import InputError
from ..scenes.forks import refuse_forked
from .builtin import BUILTIN, WITHHELD
from .chain import chained_function, check_chain
from .labels import LINK, check_parameters, format_label, links_of, parse_label
from .points import ENTRY_POINT_GROUP, plugin_points
from .result import check_result
from .rig import read_rig
from .unknown import few_of_its_kind, unknown_estimator

__all__ = [
    "ENTRY_POINT_GROUP", "Estimator", "estimator", "get_estimator", "list_estimators", "refuse_unknown", "run_estimator",
]  # fmt: skip

_MARK = "__beambench_estimator__"
_F = TypeVar("_F", bound=Callable[..., xr.Dataset])


@dataclass(frozen=True)
class Estimator:
    """A registered algorithm: `function(capture, **params) -> Dataset`, its stage, and the source that it cites.

    needs: pairs of a path in the declared rig and the value that it must have ("detector.readout.kind", "single-photon");
    captures of other instruments are refused. links: the estimators of a chain, whose last one gives the stage.
    joint: whether an answer depends on other elements than its own, e.g. on the rows beside it.
    """

    name: str
    stage: Stage
    cites: str
    function: Callable[..., xr.Dataset]
    needs: tuple[tuple[str, str], ...] = ()
    links: tuple[Estimator, ...] = ()
    joint: bool = False

    @property
    def reads_captures(self) -> bool:
        """Whether it reads captures: by its stage, or because it is a chain."""
        return bool(self.links) or self.stage.reads_captures

    @property
    def modality(self) -> str:
        """The modality of the captures that the estimator, or the chain before it, reads."""
        return self.stage.modality

    def unfit(self, capture: xr.Dataset) -> str:
        """Reason why this estimator cannot read captures of the declared rig, "" if it can; depends on the rig only, never
        on the data."""
        if not self.needs:
            return ""
        try:
            rig = read_rig(capture)
        except InputError:
            path, needed = self.needs[0]
            return f"reads rigs whose {path} is {needed}, and the declared rig cannot be read"
        for path, needed in self.needs:
            if (value := rig.get(path)) != needed:
                return f"reads rigs whose {path} is {needed}, not {value}"
        return ""

    def __call__(self, capture: xr.Dataset, **params: Any) -> xr.Dataset:
        """Run on a capture; parameters and result are checked. Raises InputError."""
        refuse_forked()
        checked = check_parameters(self.function, params, where=self.name)
        if not self.reads_captures:
            raise InputError(
                f"Estimator {self.name} reads results of another stage, not captures.", where=f"stage {self.stage.word}",
                value=", ".join(self.stage.takes), allowed="an estimator whose stage reads captures",
                next_step=f"put one before it that gives its input: FIRST{LINK}{self.name}",
            )  # fmt: skip
        modality = str(capture.attrs.get("modality", ""))
        if modality != self.modality:
            raise InputError(
                f"Estimator {self.name} reads {self.modality} captures, and this capture is of another modality.",
                where="attribute modality",
                value=modality,
                allowed=self.modality,
            )
        if reason := self.unfit(capture):
            raise InputError(f"Estimator {self.name} {reason}.", where="attribute rig", allowed="another estimator")
        return check_result(self.function(capture, **checked), capture, self.name, self.stage)


def estimator(
    stage: str, *, cites: str, needs: Mapping[str, str] | None = None, joint: bool = False
) -> Callable[[_F], _F]:
    """Mark a function as an estimator.

    Main arguments:
        stage: what the function reads and gives, a word of `captures.layouts.stages()`: "gated", "line", "centroid", …
        cites: source of the algorithm (author, year, number).
    Other arguments:
        needs: {path in the declared rig: value} without which the method has no meaning. Captures of other instruments are
            refused with that reason; a suite shows them as skipped.
        joint: whether an answer depends on other elements than its own (smoothing along a line); such an estimator is not held
            to the laws of independent elements.

    Raises InputError for an unknown stage or an empty `cites`.
    """
    word = stage_of(stage).word
    if not cites.strip():
        raise InputError("An estimator must name its source.", where="@estimator(cites=...)", value=cites)
    for path in needs or {}:
        # A property of the instrument may be needed; its name would disclose the scene.
        if path.split(".")[-1] == "name":
            raise InputError(
                "An estimator cannot need the name of a rig.", where="@estimator(needs=...)", value=path,
                allowed="a property of the instrument",
            )  # fmt: skip

    def mark(function: _F) -> _F:
        setattr(function, _MARK, (word, cites, tuple(sorted((needs or {}).items())), joint))
        return function

    return mark


def _plugins() -> dict[str, EntryPoint]:
    import sys

    return _plugins_on(tuple(sys.path))


@lru_cache(maxsize=4)
def _plugins_on(path: tuple[str, ...]) -> dict[str, EntryPoint]:
    # Kept per search path: a scan of all installed packages takes as long as an estimator does.
    found: dict[str, EntryPoint] = {}
    for point in plugin_points():
        other = found[point.name].value if point.name in found else BUILTIN.get(point.name)
        if other is not None and other != point.value:
            raise InputError(
                f"Two estimators are named {point.name}.",
                where=f"entry-point group {ENTRY_POINT_GROUP}",
                value=[other, point.value],
                next_step="rename or uninstall one of the two packages",
            )
        found[point.name] = point
    return found


def _targets() -> dict[str, str]:
    return {**BUILTIN, **{name: point.value for name, point in _plugins().items()}}


def _describe(name: str, function: Any, where: str) -> Estimator:
    mark = getattr(function, _MARK, None)
    if not callable(function) or mark is None:
        raise InputError(
            f"Estimator {name} is not a marked function.",
            where=where,
            value=function,
            allowed='a function under @estimator("gated", cites="...")',
        )
    word, cites, needs, joint = cast("tuple[str, str, tuple[tuple[str, str], ...], bool]", mark)
    return Estimator(name=name, stage=stage_of(word), cites=cites, function=function, needs=needs, joint=joint)


def get_estimator(name: str) -> Estimator:
    """The estimator called `name`, or the chain `first+second`. Raises InputError where one is unknown, withheld, unmarked or
    cannot be imported, or where the links do not follow each other."""
    if LINK in name:
        return _chain(tuple(get_estimator(part) for part in links_of(name)))
    targets = _targets()
    if name not in targets and name in WITHHELD:
        why, ours = WITHHELD[name]
        raise InputError(
            why, where="estimators", value=name, allowed=few_of_its_kind(ours, targets),
            next_step=f"did you mean {ours}, which had this name before?",
        )  # fmt: skip
    if name not in targets:
        raise unknown_estimator(name, targets)
    module, _, attribute = targets[name].partition(":")
    try:
        function = getattr(importlib.import_module(module), attribute)
    except (Exception, SystemExit) as error:  # a plug-in is foreign code: whatever its import raises is reported
        reason = f"{type(error).__name__}: {error}"
        raise InputError(
            f"Estimator {name} cannot be imported: {reason}.",
            where=targets[name],
            next_step="check the plug-in package",
        ) from error
    return _describe(name, function, targets[name])


@lru_cache(maxsize=64)
def _chain(links: tuple[Estimator, ...]) -> Estimator:
    check_chain(links)
    needs = tuple(dict.fromkeys(need for link in links for need in link.needs))
    cites = "; ".join(link.cites for link in links)
    name = LINK.join(link.name for link in links)
    joint = any(link.joint for link in links)
    return Estimator(name, links[-1].stage, cites, chained_function(links), needs, links, joint)


def refuse_unknown(names: Iterable[str]) -> None:
    """Raise InputError for the first of `names` that is no estimator's; nothing is imported."""
    targets = _targets()
    for name in names:
        if name not in targets:
            raise unknown_estimator(name, targets)


def list_estimators(modality: str | None = None) -> tuple[str, ...]:
    """Sorted names of all estimators, or of those that read captures of one modality (which imports all of them)."""
    names = sorted(_targets())
    if modality is None:
        return tuple(names)
    return tuple(name for name in names if get_estimator(name).modality == modality)


def run_estimator(label: str | Callable[..., xr.Dataset] | Estimator, capture: xr.Dataset) -> xr.Dataset:
    """Run an estimator, given by its label `name[key=value,...]` or as a marked function, on one capture.

    Returns the quantities of the estimator's stage, e.g. range, sigma [m] and valid, with the attributes `estimator` (the
    label) and `cites`.
    Raises InputError for an unknown name or parameter, and for a result that breaks the contract of the stage.
    """
    if isinstance(label, str):
        name, params = parse_label(label)
        chosen = get_estimator(name)
    elif isinstance(label, Estimator):
        chosen, params = label, {}
    else:
        chosen, params = _describe(getattr(label, "__name__", "function"), label, "run_estimator"), {}
    result = chosen(capture, **params)
    result.attrs["estimator"] = format_label(chosen.name, params)
    result.attrs["cites"] = chosen.cites
    return result
