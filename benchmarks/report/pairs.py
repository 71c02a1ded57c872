"""The matrix of pairs on the page: pairs.csv of a run, every estimator against every other."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..scores.tables import read_numbers
from .numbers import number, span

__all__ = ["pairs_section"]

_GROUP = ("modality", "stage", "quantity", "condition")
_NUMBERS = ("scenes", "ratio", "ratio_lo", "ratio_hi", "p_holm")


def pairs_section(folder: Path) -> list[dict[str, Any]]:
    """One matrix per modality, stage, quantity and condition: names, and rows of cells.

    The cell of row a and column b holds a's error over b's (geometric mean over scenes): below 1, a is better. `kind` is "better"
    or "worse" where the difference is significant (`winner` of the table), else "open"; None on the diagonal.

    Raises:
        InputError: pairs.csv is not such a table.
    """
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    texts = (*_GROUP, "a", "b", "winner")
    for row in read_numbers(folder / "pairs.csv", _NUMBERS, "The table of pairs", texts=texts):
        if not row["quantity"].endswith("-mixed"):
            groups.setdefault(tuple(row[name] for name in _GROUP), []).append(row)
    return [_matrix(key, rows) for key, rows in groups.items()]


def _matrix(key: tuple[str, ...], rows: list[dict[str, Any]]) -> dict[str, Any]:
    names = list(dict.fromkeys(row[side] for row in rows for side in ("a", "b")))
    cells: dict[tuple[str, str], dict[str, Any]] = {}
    score = dict.fromkeys(names, 0.0)  # the best first: by mean ln of the ratios
    for row in rows:
        a, b, ratio = row["a"], row["b"], row["ratio"]
        cells[a, b] = _cell(ratio, row["ratio_lo"], row["ratio_hi"], row, a)
        turned, low, high = (1 / v if v else math.nan for v in (ratio, row["ratio_hi"], row["ratio_lo"]))
        cells[b, a] = _cell(turned, low, high, row, b)
        if 0 < ratio < math.inf:
            score[a] += math.log(ratio)
            score[b] -= math.log(ratio)
    order = sorted(names, key=lambda name: score[name])
    words = dict.fromkeys(word for word in key if word)
    return {
        "title": ", ".join(words),
        "names": order,
        "rows": [{"name": a, "cells": [cells.get((a, b)) for b in order]} for a in order],
    }


def _cell(ratio: float, low: float, high: float, row: dict[str, Any], name: str) -> dict[str, Any]:
    kind = "open" if not row["winner"] else "better" if row["winner"] == name else "worse"
    corrected = float(row.get("p_adjusted") or row["p_holm"])  # tables of before have Holm's only
    p = f", p {number(corrected, 2)}" if corrected == corrected else ""
    here = row.get("winner_here", "") if kind == "open" else ""
    told = f", on these scenes {'better' if here == name else 'worse'}" if here else ""
    return {"kind": kind, "text": number(ratio), "more": f"{span(low, high).strip()}{p}{told}".strip(", ")}
