"""One row of reproduction.csv, and the rules by which a verdict is given."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal, get_args

__all__ = ["COLUMNS", "DOCUMENT", "VERDICTS", "Row", "Verdict", "judge_band", "judge_exact", "judge_trend"]

#: Guo et al., "Investigate target reflection and illumination sensitivity in range gated detection".
DOCUMENT = "000"

Verdict = Literal[
    "arithmetic", "predicted", "fitted", "by-construction", "trend", "undetermined", "contradicted"
]  # fmt: skip
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


@dataclass(frozen=True)
class Row:
    """One quantity of one item: what is printed, what we get, and what that means.

    `published` is NaN where the document prints no number. `tolerance` is absolute, in `unit`, NaN where none applies.
    `free_parameters` names what was adjusted to get the value ("" for nothing).
    """

    item: str
    quantity: str
    unit: str
    published: float
    reproduced: float
    tolerance: float
    verdict: Verdict
    note: str
    free_parameters: str = ""
    document: str = DOCUMENT

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict must be one of {', '.join(VERDICTS)}, not {self.verdict!r}")
        if self.verdict == "fitted" and not self.free_parameters:
            raise ValueError(f"{self.item}, {self.quantity}: a fitted value names its free parameters")


COLUMNS = (
    "document", "item", "quantity", "unit", "published", "reproduced", "tolerance", "verdict", "free_parameters", "note",
)  # fmt: skip
assert set(COLUMNS) == {field.name for field in fields(Row)}


def judge_exact(published: float, reproduced: float, tolerance: float) -> Verdict:
    """ "arithmetic" where a number that follows from printed ones alone agrees within `tolerance`, else "contradicted"."""
    return "arithmetic" if abs(reproduced - published) <= tolerance else "contradicted"


def judge_band(published: float, low: float, high: float, tolerance: float) -> Verdict:
    """Verdict on a number that a model gives without having seen it, as a band low…high over what is not printed.

    "contradicted" where the published value lies beyond the band by more than `tolerance`. Within, "predicted" only if
    the band is no wider than the tolerance to either side (the test could have failed), else "undetermined".
    Raises ValueError for a band that is upside down or not finite.
    """
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(f"a band needs finite low <= high, not {low!r}, {high!r}")
    if published < low - tolerance or published > high + tolerance:
        return "contradicted"
    return "predicted" if high - low <= 2.0 * tolerance else "undetermined"


def judge_trend(*agrees: bool) -> Verdict:
    """ "trend" where the direction that the text states is found in every part of the check, else "contradicted"."""
    if not agrees:
        raise ValueError("a trend needs at least one comparison")
    return "trend" if all(agrees) else "contradicted"
