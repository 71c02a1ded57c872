"""One row of reproduction.csv, and the rules by which a verdict is given."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal, get_args

__all__ = [
    "COLUMNS", "DOCUMENT", "DOCUMENTS", "VERDICTS", "WEAKEST_FIRST", "Row", "Verdict", "judge_band", "judge_exact",
    "judge_settings", "weakest",
]  # fmt: skip

#: Guo et al. 2017, "Investigate target reflection and illumination sensitivity in range gated detection".
DOCUMENT = "000"
#: Values of the column `document`. A number of another source is listed under the document it relates to, source in `item`.
DOCUMENTS = ("000", "001")

Verdict = Literal[
    "arithmetic", "predicted", "fitted", "by-construction", "trend", "undetermined", "contradicted"
]  # fmt: skip
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)

#: Which verdict an item has if its rows differ: the first of these that occurs, so that no item claims more than its rows.
WEAKEST_FIRST: tuple[Verdict, ...] = (
    "undetermined", "contradicted", "by-construction", "fitted", "trend", "predicted", "arithmetic",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One quantity of one item: the published value, the reproduced one, and the verdict.

    `published` is a number that the document prints, NaN where it prints none. `tolerance` is absolute, in `unit`, NaN where
    none applies. `free_parameters` names what was adjusted, or chosen by us, to get the value ("" for nothing).

    Raises ValueError where the verdict claims more than the numbers allow: "arithmetic" and "predicted" state an agreement,
    so the numbers must agree within a tolerance. "predicted" needs a printed number; "arithmetic" needs one, or a ratio of
    two printed expressions ("A over B"), which is to be one. "by-construction" compares with nothing, so it has neither
    number nor tolerance; "fitted" and "by-construction" must name their free parameters.
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
        printed = math.isfinite(self.published)
        if self.verdict == "predicted" and not printed:
            raise ValueError(f"{name}: predicted needs a published number")
        if self.verdict == "arithmetic" and not (printed or (self.unit == "1" and " over " in self.quantity)):
            raise ValueError(f"{name}: arithmetic needs a published number or a ratio of two printed expressions")
        aim = self.published if printed else 1.0
        if self.verdict == "arithmetic" and not abs(self.reproduced - aim) <= self.tolerance:
            raise ValueError(
                f"{name}: arithmetic needs an agreement of {self.reproduced!r} with {aim!r} within a tolerance"
            )
        if self.verdict == "predicted" and not math.isfinite(self.tolerance):
            raise ValueError(f"{name}: predicted needs a tolerance")
        if self.verdict == "by-construction" and not (math.isnan(self.published) and math.isnan(self.tolerance)):
            raise ValueError(f"{name}: by-construction must have no published number and no tolerance")
        if self.verdict in ("fitted", "by-construction") and not self.free_parameters:
            raise ValueError(f"{name}: {self.verdict} must name its free parameters")


COLUMNS = (
    "document", "item", "quantity", "unit", "published", "reproduced", "tolerance", "verdict", "free_parameters", "note",
)  # fmt: skip
assert set(COLUMNS) == {field.name for field in fields(Row)}
assert set(WEAKEST_FIRST) == set(VERDICTS)


def judge_exact(published: float, reproduced: float, tolerance: float) -> Verdict:
    """ "arithmetic" where a number that follows from printed ones alone agrees within `tolerance`, else "contradicted"."""
    return "arithmetic" if abs(reproduced - published) <= tolerance else "contradicted"


def judge_band(published: float, low: float, high: float, tolerance: float, guesses: Iterable[float] = ()) -> Verdict:
    """Verdict on a number predicted by a model without a fit, as a band low…high over the parameters that are not printed.

    "contradicted" where the published value lies beyond the band by more than `tolerance`. Within, "predicted" only if
    the test had power: the band is no wider than the tolerance to either side, and none of the `guesses` (numbers that need
    no model, such as "the same as for the other object") agrees with the published value as well. Otherwise "undetermined".
    Raises ValueError for a band with low > high or ends that are not finite.
    """
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError(f"a band needs finite low <= high, not {low!r}, {high!r}")
    if published < low - tolerance or published > high + tolerance:
        return "contradicted"
    guessed = any(abs(guess - published) <= tolerance for guess in guesses)
    return "predicted" if high - low <= 2.0 * tolerance and not guessed else "undetermined"


def judge_settings(outcomes: Iterable[bool]) -> Verdict:
    """Verdict on a stated direction, checked for each plausible setting of the parameters that the document does not give.

    "trend" where all settings show it, "contradicted" where none does, "undetermined" where it depends on the setting.
    Raises ValueError for no outcome at all.
    """
    found = set(map(bool, outcomes))
    if not found:
        raise ValueError("a verdict over settings needs at least one outcome")
    return "undetermined" if len(found) == 2 else "trend" if True in found else "contradicted"


def weakest(verdicts: Iterable[Verdict]) -> Verdict:
    """The verdict on an item: the first of WEAKEST_FIRST among those of its rows. Raises ValueError for no row."""
    found = set(verdicts)
    if not found:
        raise ValueError("an item without rows has no verdict")
    return next(verdict for verdict in WEAKEST_FIRST if verdict in found)
