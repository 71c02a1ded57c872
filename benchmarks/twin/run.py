"""Ask for a certificate, and write it down: a page, a table of clauses, and how to repeat it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from ...captures.hide import hide_truth_but_ranges
from ...scenes.errors import InputError
from ...scenes.records import object_at
from ..folders.files import write_json, write_text
from ..judges import JUDGES, judge_of
from ..scores.tables import to_csv
from .certificate import Certificate
from .clause import Ask, TwinKind
from .page import certificate_page
from .verdict import ALPHA, judged, with_tolerances

__all__ = ["COLUMNS", "certified", "twin_kind_of", "write_certificate"]

COLUMNS = (
    "clause", "title", "unit", "real", "twin", "bound", "difference", "low", "high", "level", "tolerance", "verdict", "coverage",
    "remark", "tolerance_from", "follows", "cannot_show",
)  # fmt: skip


def twin_kind_of(modality: object) -> TwinKind:
    """The record of a modality. Raises InputError for one without clauses."""
    place = judge_of(modality).twin
    if not place:
        raise InputError(
            "There are no clauses for such recordings yet.", where="modality", value=modality,
            allowed=", ".join(name for name in JUDGES if judge_of(name).twin),
            next_step="`beambench estimate` and `beambench score` take such recordings",
        )  # fmt: skip
    found: TwinKind = object_at(place)
    return found


def certified(
    capture: xr.Dataset, ask: Ask, tolerances: Mapping[str, float] | None = None, required: Sequence[str] = ()
) -> Certificate:
    """The certificate of a recording. Raises InputError for a recording or rig that cannot be compared, or an unknown clause."""
    kind = twin_kind_of(capture.attrs.get("modality"))
    clauses = with_tolerances(kind.clauses, tolerances or {})
    names = [clause.name for clause in clauses]
    if unknown := [name for name in required if name not in names]:
        raise InputError(
            "There is no such clause.", where="--require", value=unknown[0], allowed=", ".join(names)
        )  # fmt: skip
    if ask.draws < 8:
        raise InputError(
            "So few draws of a twin give no interval.", where="draws", value=ask.draws, allowed="8 or more"
        )
    evidence = kind.measure(hide_truth_but_ranges(capture), ask)
    return Certificate(tuple(judged(clauses, evidence)), evidence, str(capture.attrs["modality"]), tuple(required))


def rows_of(certificate: Certificate) -> list[dict[str, Any]]:
    """The clauses as rows of clauses.csv."""
    return [
        {
            "clause": one.clause.name, "title": one.clause.title, "unit": one.clause.unit, "real": one.real, "twin": one.twin,
            "bound": one.bound, "difference": one.real - one.twin, "low": one.low, "high": one.high, "level": one.level,
            "tolerance": one.tolerance, "verdict": one.verdict, "coverage": one.coverage,
            "remark": one.remark, "tolerance_from": one.clause.why, "follows": one.clause.follows, "cannot_show": one.clause.cannot,
        }
        for one in certificate.clauses
    ]  # fmt: skip


def write_certificate(certificate: Certificate, source: str, out: Path, record: Mapping[str, Any]) -> None:
    """Write certificate.html, clauses.csv and run.json into a folder. Raises InputError where they cannot be written."""
    rows = rows_of(certificate)
    write_text(out / "clauses.csv", to_csv(rows, list(COLUMNS)))
    write_json(
        out / "run.json",
        {
            **record, "recording": source, "verdict": certificate.verdict, "alpha": ALPHA, "modality": certificate.modality,
            "about": list(certificate.evidence.about),
            "clauses": [{key: _plain(value) for key, value in row.items()} for row in rows],
        },
    )  # fmt: skip
    write_text(out / "certificate.html", certificate_page(certificate, source, _typed(record)))


def _typed(record: Mapping[str, Any]) -> Sequence[str]:
    typed = record.get("command", ())
    return [str(word) for word in typed] if isinstance(typed, list | tuple) else []


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
