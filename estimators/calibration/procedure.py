"""A procedure of calibration, and what it finds: values of a rig by their paths, each with its standard error."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from typing import Any

from ...scenes.errors import InputError
from ..labels import check_parameters, parse_label

__all__ = ["PROCEDURES", "Calibrated", "Figure", "Procedure", "procedure_of"]

#: Name -> "module:object". A new procedure is one file of this folder with its record, and its line here.
PROCEDURES: dict[str, str] = {
    "emva1288": "beambench.estimators.calibration.emva1288:EMVA1288",
    "delay-scan": "beambench.estimators.calibration.gated_delay_scan:DELAY_SCAN",
    "boards": "beambench.estimators.calibration.laser_line_boards:BOARDS",
    "lenslets": "beambench.estimators.calibration.wavefront_lenslets:LENSLETS",
}


@dataclass(frozen=True)
class Figure:
    """A figure that a procedure found.

    Main arguments:
        name, unit, value, sigma: sigma is the standard error (1 σ), NaN where none can be stated.
    Other arguments:
        path: the value of a rig file that it is, e.g. "rig.detector.read_noise_e", or an element of a list that `Calibrated.values`
            holds, "rig.laser.position_m.0"; "" for a figure that no rig holds.
        note: what a reader must know of it.
    """

    name: str
    unit: str
    value: float
    sigma: float
    path: str = ""
    note: str = ""


@dataclass(frozen=True)
class Calibrated:
    """What a procedure found.

    Main arguments:
        figures: in the order in which they are shown; those with a path go into the rig file, with their standard errors.
    Other arguments:
        values: further values of the rig {path: value} that are no single number, e.g. samples of a pulse, or have no error.
        sigmas: their standard errors {path: 1 σ}.
        used: what was used, {name: number or text}, for the file's record.
    """

    figures: tuple[Figure, ...]
    values: Mapping[str, Any] = field(default_factory=dict)
    sigmas: Mapping[str, float] = field(default_factory=dict)
    used: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Procedure:
    """A procedure.

    Main arguments:
        name: its name. line: what it finds, one line for people.
        lacking: captures without their truth (`Sequence[xr.Dataset]`) -> what they lack for this procedure, "" where they hold all.
        run: the same captures -> `Calibrated`; raises InputError where they cannot be used.

    What a user must tell are keyword-only arguments of both, of equal names, typed as `name[key=value,...]`; `lacking` says what to
    type where one is missing. Captures are read one by one, each time anew: the sequence may load them from disk.
    """

    name: str
    line: str
    lacking: Callable[..., str]
    run: Callable[..., Calibrated]


def procedure_of(label: object) -> Procedure:
    """The procedure of a label, `name` or `name[key=value,...]`, with its parameters set.

    Raises InputError for an unknown name, and for a parameter that is unknown or of another type.
    """
    text = label if isinstance(label, str) else ""
    name, params = parse_label(text) if "[" in text else (text, {})
    if name not in PROCEDURES:
        raise InputError(
            "There is no such procedure of calibration.",
            where="--procedures",
            value=label,
            allowed=", ".join(PROCEDURES),
        )
    module, _, attribute = PROCEDURES[name].partition(":")
    found: Procedure = getattr(import_module(module), attribute)
    if not params:
        return found
    given = check_parameters(found.run, params, where=name, what="Procedure")
    return replace(found, lacking=partial(found.lacking, **given), run=partial(found.run, **given))
