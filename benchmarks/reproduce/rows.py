"""One row of reproduction.csv, and the rules by which a verdict is given."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal, get_args

__all__ = [
    "COLUMNS", "DOCUMENT", "DOCUMENTS", "VERDICTS", "Row", "Verdict", "judge_band", "judge_exact", "judge_settings",
    "judge_trend",
]  # fmt: skip

#: Guo et al. 2017, "Investigate target reflection and illumination sensitivity in range gated detection".
DOCUMENT = "000"
#: Values of the column `document`. A number of another source is listed under the document it relates to, source in `item`.
DOCUMENTS = ("000", "001")

Verdict = Literal[
    "arithmetic", "predicted", "fitted", "by-construction", "trend", "undetermined", "contradicted"
]  # fmt: skip
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


@dataclass(frozen=True)
class Row:
    """One quantity of one item: the published value, the reproduced one, and the verdict.

    `published` is NaN where the document prints no number. `tolerance` is absolute, in `unit`, NaN where none applies.
    `free_parameters` names what was adjusted, or chosen by us, to get the value ("" for nothing).

    Raises ValueError where the verdict claims more than the numbers allow: "arithmetic" and "predicted" state an agreement,
    so they need a published number and a tolerance; "by-construction" compares with nothing, so it has neither; "fitted"
    and "by-construction" must name their free parameters.
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
        name = f"{self.item}, {self.quantity}"
        if self.document not in DOCUMENTS:
            raise ValueError(f"{name}: document must be one of {', '.join(DOCUMENTS)}, not {self.document!r}")
        compared = math.isfinite(self.published) and math.isfinite(self.tolerance)
        if self.verdict in ("arithmetic", "predicted") and not compared:
            raise ValueError(f"{name}: {self.verdict} needs a published number and a tolerance")
        if self.verdict == "by-construction" and not (math.isnan(self.published) and math.isnan(self.tolerance)):
            raise ValueError(f"{name}: by-construction must have no published number and no tolerance")
        if self.verdict in ("fitted", "by-construction") and not self.free_parameters:
            raise ValueError(f"{name}: {self.verdict} must name its free parameters")


COLUMNS = (
    "document", "item", "quantity", "unit", "published", "reproduced", "tolerance", "verdict", "free_parameters", "note",
)  # fmt: skip
assert set(COLUMNS) == {field.name for field in fields(Row)}


def judge_exact(published: float, reproduced: float, tolerance: float) -> Verdict:
    """ "arithmetic" where a number that follows from printed ones alone agrees within `tolerance`, else "contradicted"."""
    return "arithmetic" if abs(reproduced - published) <= tolerance else "contradicted"


def judge_band(published: float, low: float, high: float, tolerance: float) -> Verdict:
    """Verdict on a number predicted by a model without a fit, as a band low…high over the parameters that are not printed.

    "contradicted" where the published value lies beyond the band by more than `tolerance`. Within, "predicted" only if
    the band is no wider than the tolerance to either side (the test could have failed), else "undetermined".
    Raises ValueError for a band with low > high or ends that are not finite.
    """
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(f"a band needs finite low <= high, not {low!r}, {high!r}")
    if published < low - tolerance or published > high + tolerance:
        return "contradicted"
    return "predicted" if high - low <= 2.0 * tolerance else "undetermined"


def judge_settings(outcomes: Iterable[bool]) -> Verdict:
    """Verdict on a stated direction, checked for each plausible setting of the parameters that the document does not give.

    "trend" where all settings show it, "contradicted" where none does, "undetermined" where it depends on the setting.
    Raises ValueError for no outcome at all.
    """
    found = set(map(bool, outcomes))
    if not found:
        raise ValueError("a verdict over settings needs at least one outcome")
    return "undetermined" if len(found) == 2 else "trend" if True in found else "contradicted"


def judge_trend(*agrees: bool) -> Verdict:
    """ "trend" where the direction stated in the text holds in every part of the check, else "contradicted"."""
    if not agrees:
        raise ValueError("a trend needs at least one comparison")
    return "trend" if all(agrees) else "contradicted"
