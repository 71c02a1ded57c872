"""One figure of one estimator, and what the gate says of it.

Every check states a change (new against old, positive is worse), its standard error and the *effect of interest*: the least
change that must not pass. With p of the one-sided test of «no change», corrected for all checks of the gate by Holm's method,

    regression   p <= α and the change is at least half of the effect;
    pass         equal numbers, or the upper 95 % limit of the change is below the effect;
    abstains     neither: what was measured cannot tell a change of that size from none.

A change at half of the effect or more that is certain is red, so that one of the full effect is not missed by the scatter of
its estimate; a certain one of less than that is not of interest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ..statistics.pairs import holm

__all__ = ["ABSTAINS", "ALPHA", "PASS", "REGRESSION", "Check", "abstained", "decided", "equal", "measured", "verdict"]

State = Literal["", "pass", "regression", "abstains"]
PASS: State = "pass"
REGRESSION: State = "regression"
ABSTAINS: State = "abstains"

#: Chance of one false alarm or more in a whole gate.
ALPHA = 0.01
_MISSED = 0.05  # chance, per check, that a change of the effect's size passes


@dataclass(frozen=True)
class Check:
    """One check.

    Main arguments:
        figure: "accuracy", "failures", "coverage", "sigma", "speed", "memory". subject: estimator, quantity, condition.
        change, high: change and its upper limit, in the unit of `effect`. p: one-sided; NaN where nothing was tested.
    Other arguments:
        state: "" before `decided`. note: how it was measured, or the reason why the gate abstains.
    """

    figure: str
    subject: str
    change: float = math.nan
    high: float = math.nan
    effect: float = math.nan
    p: float = math.nan
    p_holm: float = math.nan
    state: State = ""
    note: str = ""


def measured(
    figure: str, subject: str, change: float, error: float, freedom: float, effect: float, note: str = ""
) -> Check:
    """A check from a change and its standard error with a number of degrees of freedom (infinite: normal)."""
    from scipy.stats import norm, t

    error = max(error, 1e-12)  # exact repetitions: any change of interest is then certain
    law = norm if math.isinf(freedom) else t(freedom)
    return Check(
        figure, subject, change, change + float(law.ppf(1.0 - _MISSED)) * error, effect,
        float(law.sf(change / error)), note=note,
    )  # fmt: skip


def equal(figure: str, subject: str, effect: float, note: str = "equal numbers") -> Check:
    """A check whose numbers are equal: it passes. Nothing is tested, so that it does not count in the correction."""
    return Check(figure, subject, 0.0, 0.0, effect, note=note)


def abstained(figure: str, subject: str, reason: str, effect: float = math.nan) -> Check:
    """A check that could not be made, with the reason."""
    return Check(figure, subject, effect=effect, state=ABSTAINS, note=reason)


def decided(checks: Sequence[Check], alpha: float = ALPHA) -> list[Check]:
    """The checks with their states and corrected p."""
    corrected = holm([check.p for check in checks])
    return [_decide(replace(check, p_holm=float(p)), alpha) for check, p in zip(checks, corrected, strict=True)]


def _decide(check: Check, alpha: float) -> Check:
    if check.state == ABSTAINS:
        return check
    if check.p_holm <= alpha and check.change >= 0.5 * check.effect:
        return replace(check, state=REGRESSION)
    if check.high < check.effect:
        return replace(check, state=PASS)
    reason = "a change of the effect's size can neither be shown nor excluded"
    return replace(check, state=ABSTAINS, note=f"{reason}; {check.note}" if check.note else reason)


def verdict(checks: Iterable[Check]) -> State:
    """The gate's verdict: a regression before an abstention before a pass; without any check it abstains."""
    states = {check.state for check in checks}
    if REGRESSION in states:
        return REGRESSION
    return ABSTAINS if ABSTAINS in states or PASS not in states else PASS
