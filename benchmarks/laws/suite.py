"""The laws that every estimator is held to, for every modality, as functions (estimator, maker) -> what is wrong.

A law returns "" where it holds. What it needs to know of a modality it reads from the layout, the stage and the record
`Laws` of the modality.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...captures.quantities import possible_sigma, possible_value
from ...estimators.result import check_result
from ...scenes.errors import InputError
from ..judges.bound import truths_of
from ..scores.slips import LEAST_ELEMENTS, slips_of
from .maker import Answer, Change, Maker, Run
from .memory import no_state, own_answers, own_rig
from .singular import SINGULARITIES
from .spoilt import SPOILT

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Law", "LawResult", "Report", "judged", "laws_for", "named"]

#: By how much of the shift an answer may miss it. Weights by range, as r³/r², add 2σ²/r, which changes by 2σ²Δ/r² with a
#: shift Δ: by 6e-4 of it for a response of σ = 75 mm at r = 5 m. Iterations stop within a hundredth of a standard error.
SHIFT_TOLERANCE = 1e-3
#: By how many steps (`Laws.step`) an answer may move with the gain g. The variance of rounding, 1/12 DN², is 1/(12 g²)
#: electrons²: when g is doubled from 1 DN per electron, a floor of 9 electrons² falls by .7 %, a threshold of 8 standard
#: deviations of it by .08 electrons, which the rise of an echo of 700 electrons passes within 2e-3 of a step.
GAIN_TOLERANCE = 5e-3
#: Relative difference of answers that only the order of the elements tells apart: a view of 1.6e-4 rad to either side
#: corrects ranges by 1 − cos = 1.3e-8, sums in another order round by less.
ORDER_RTOL = 1e-7
#: By how many steps dead elements may move the answers of the others: a method may take the median height of a capture's
#: echoes, and has fewer of them.
DEAD_TOLERANCE = 1e-2
#: Standard errors that the answers without some samples may be off. The answer of fewer data minus that of all has the
#: variance σ² − σ_all² < σ² (J. A. Hausman, Econometrica 46:1251, 1978): of n elements its mean over σ lies within 1/√n of 0,
#: and its root mean square within 1/√(2n) of 1 or less.
SPOILT_ERRORS = 4.0

#: By how much the scatter of answers to other noise may exceed their sigma, beyond chance: a sigma that is read off few
#: photoelectrons, or leaves out a reference that all elements share, is a tenth or two too small.
SCATTER = 1.25
#: Answers that the law of scatter compares at least, and the most pairs of captures it takes for them.
_ENOUGH, _MOST_PAIRS = 32, 4

Law = Callable[[Run, Maker], str]


@dataclass(frozen=True)
class LawResult:
    """One law: its name, whether it held, and what was seen."""

    law: str
    holds: bool
    seen: str


Report = Callable[[str, "LawResult | None"], bool]


def laws_for(maker: Maker) -> dict[str, Law]:
    """The laws of a stage by their names."""
    noun = maker.layout.noun
    laws: dict[str, Law] = {
        "keeps the contract of its stage": contract,
        "answers a bright, clean capture": answers,
        "valid answers have a positive sigma": positive_sigma,
        "answers are in the unit and order of the stage": unit_and_order,
        "answers to other noise scatter within their sigma": scatter,
        "same answer twice": repeats,
        "leaves its input alone": leaves_input,
        "other data have their own answer": own_answers,
        "the declared rig is read anew": own_rig,
        "no state between captures": no_state,
    }
    # A later stage may know what the place of an element means, as a camera's rows do; so may one that reads whole images.
    if maker.stage.word not in maker.laws.steps:
        laws[f"shift: {maker.laws.shift}"] = shift
        if not maker.joint:
            laws[f"{noun}s do not depend on their order"] = permutation
    if maker.doubled() is not None:
        laws["gain: twice the gain and the counts, the same answer"] = gain
    for name, change in SINGULARITIES.items():
        if made := change(maker):
            laws[f"finite or invalid: {name}"] = partial(_singular, change=made)
    for name, make in SPOILT.items():
        if (capture := make(maker)) is not None:
            laws[f"true or refused: {name}"] = partial(_spoilt, capture=capture)
    if not maker.joint:
        laws[f"dead {noun}s leave the others alone"] = dead_elements
    return laws


def named(run: Run, maker: Maker) -> dict[str, Callable[[], str]]:
    """The laws of a stage, bound to one estimator."""
    return {name: partial(law, run, maker) for name, law in laws_for(maker).items()}


def judged(laws: Mapping[str, Callable[[], str]], report: Report | None = None) -> list[LawResult]:
    """Try laws, given as functions that return what is wrong, "" for nothing.

    `report` is called as each law begins, with (name, None), and with its result, (name, result); a law for which it returns
    False as it begins is left out. What a law raises breaks it, `sys.exit` included; an interrupt by the user ends the check.
    """
    results = []
    for name, law in laws.items():
        if report is not None and not report(name, None):
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                problem = law()
        except (Exception, SystemExit) as error:  # code of others: whatever it raises is a result
            problem = f"{type(error).__name__}: {error}"
        results.append(LawResult(name, not problem, problem or "holds"))
        if report is not None:
            report(name, results[-1])
    return results


def contract(run: Run, maker: Maker) -> str:
    """The result has the variables, dimensions and types of the stage; its values are the subject of other laws."""
    import xarray as xr

    result = run(maker.clean())
    if isinstance(result, xr.Dataset):
        flags = {maker.stage.variables(quantity).valid for quantity in maker.stage.gives} & set(result.variables)
        result = result.assign({name: xr.zeros_like(result[name]) for name in flags})
    try:
        check_result(result, maker.clean(), "under test", maker.stage)
    except InputError as error:
        return error.what
    return ""


def answers(run: Run, maker: Maker) -> str:
    """More than half of the elements are answered where nothing is difficult."""
    share = float(maker.first(run(maker.clean())).valid.mean())
    return "" if share > 0.5 else f"Only {share:.0%} of the {maker.layout.noun}s are answered."


def positive_sigma(run: Run, maker: Maker) -> str:
    """Every valid answer has a finite standard error above 0."""
    bad = sum(int((a.valid & ~possible_sigma(a.sigma)).sum()) for a in maker.answers(run(maker.clean())))
    return f"Valid answers without a positive sigma: {bad}." if bad else ""


def unit_and_order(run: Run, maker: Maker) -> str:
    """No other unit, and no exchange of rows and columns, brings the answers to a clean capture far closer to its truth."""
    result = run(maker.clean())
    dims = maker.stage.dims()
    arrays = {name: result[name].transpose(*dims[name]).values for name in dims}
    slips = slips_of(maker.stage, arrays, truths_of(maker.with_truth()))
    return " ".join(
        f"The {row['quantity']} seems to be {row['slip']}: when that is mended, the median error falls from {row['before']:.3g} to "
        f"{row['after']:.3g}."
        for row in slips
        if row["elements"] >= LEAST_ELEMENTS
    )


def scatter(run: Run, maker: Maker) -> str:
    """Answers a, b to two draws of the noise differ by √(σ_a² + σ_b²) or less, in the root mean square over elements. A stated
    error may hold more than the noise, such as a bias within the sample; it may not hold less."""
    parts: list[np.ndarray] = []
    for pair in range(_MOST_PAIRS):
        one, two = (maker.first(run(maker.redrawn(2 * pair + k))) for k in (1, 2))
        both = one.valid & two.valid if one.valid.shape == two.valid.shape else np.zeros(0, bool)
        if both.any():
            parts.append((one.value[both] - two.value[both]) / np.hypot(one.sigma[both], two.sigma[both]))
        if sum(part.size for part in parts) >= _ENOUGH:
            break
    z = np.concatenate(parts) if parts else np.zeros(0)
    rms = float(np.sqrt((z**2).mean())) if z.size else 0.0
    if rms <= SCATTER + SPOILT_ERRORS / np.sqrt(2 * max(z.size, 1)):
        return ""
    return f"The {z.size} answers to other noise scatter by {rms:.2g} of their sigma."


def repeats(run: Run, maker: Maker) -> str:
    """Two calls on one capture give the same numbers, bit by bit."""
    one, two = (maker.answers(run(maker.clean())) for _ in range(2))
    return "" if all(map(_same, one, two)) else "Two calls on one capture give different answers."


def leaves_input(run: Run, maker: Maker) -> str:
    """The capture is after the call what it was before."""
    capture = maker.clean()
    run(capture)
    return "" if capture.identical(maker.clean()) else "The capture was changed."


def shift(run: Run, maker: Maker) -> str:
    """A capture that is moved as a whole moves the answers by as much, and the same elements are answered."""
    capture, change = maker.later()
    base, moved = maker.first(run(maker.clean())), maker.first(run(capture))
    if (base.valid != moved.valid).any():
        return f"The shift decides whether a {maker.layout.noun} is answered."
    error = _worst(moved.value - base.value - change, base.valid)
    if error <= SHIFT_TOLERANCE * abs(change):
        return ""
    return f"A shift of {change / maker.step:.3g} steps is missed by {error / maker.step:.2g} steps."


def gain(run: Run, maker: Maker) -> str:
    """Twice the gain and twice the counts are the same photoelectrons, and give the same answers."""
    twice = maker.doubled()
    assert twice is not None, "the law is left out for detectors without a converter"
    base, other = maker.first(run(maker.clean())), maker.first(run(twice))
    if (base.valid != other.valid).any():
        return f"The gain decides whether a {maker.layout.noun} is answered."
    error = _worst(other.value - base.value, base.valid) / maker.step
    return "" if error <= GAIN_TOLERANCE else f"The answer moves by {error:.2g} steps with the gain."


def permutation(run: Run, maker: Maker) -> str:
    """Elements are independent: in another order they have the same answers, in that order."""
    order = np.random.default_rng(3).permutation(maker.elements)
    base = maker.answers(run(maker.clean()))
    mixed = maker.answers(run(maker.changed(lambda data: data[:, order])))
    same = all(_close(_taken(one, order), two) for one, two in zip(base, mixed, strict=True))
    return "" if same else f"The {maker.layout.noun}s have other answers in another order."


def dead_elements(run: Run, maker: Maker) -> str:
    """Elements without any signal are finite or invalid, and those beside them have the answers that they had."""
    dead = np.arange(maker.elements) % 3 == 1

    def kill(data: np.ndarray) -> np.ndarray:
        data[:, dead] = 0
        return data

    result = run(maker.changed(kill))
    if problem := _unsound(result, maker):
        return problem
    base, other = maker.first(run(maker.clean())), maker.first(result)
    if (base.valid != other.valid)[~dead].any():
        return f"Dead {maker.layout.noun}s decide whether others are answered."
    error = _worst(other.value - base.value, base.valid & ~dead[:, None]) / maker.step
    return "" if error <= DEAD_TOLERANCE else f"Dead {maker.layout.noun}s move the others by {error:.2g} steps."


def _singular(run: Run, maker: Maker, change: Change) -> str:
    return _unsound(run(maker.changed(change)), maker)


def _spoilt(run: Run, maker: Maker, capture: xr.Dataset) -> str:
    """Elements of which some samples are no data keep their answers within the stated errors, or have none."""
    result = run(capture.copy(deep=True))
    if problem := _unsound(result, maker):
        return problem
    base, other = maker.first(run(maker.clean())), maker.first(result)
    both = base.valid & other.valid
    z = (other.value[both] - base.value[both]) / other.sigma[both]
    if not z.size:
        return ""
    mean, rms = abs(float(z.mean())), float(np.sqrt((z**2).mean()))
    if mean <= SPOILT_ERRORS / np.sqrt(z.size) and rms <= 1 + SPOILT_ERRORS / np.sqrt(2 * z.size):
        return ""
    return f"The {z.size} {maker.layout.noun}s answered move by {mean:.2g} of their sigma in the mean, {rms:.2g} rms."


def _unsound(result: xr.Dataset, maker: Maker) -> str:
    """What is wrong with an estimate in which every answer should be finite, with a positive sigma, or invalid."""
    bad = 0
    for answer in maker.answers(result):
        with np.errstate(invalid="ignore"):
            sound = possible_value(answer.value) & possible_sigma(answer.sigma)
        bad += int((answer.valid & ~sound).sum())
    return f"Valid answers without a finite value and a positive sigma: {bad}." if bad else ""


def _worst(error: np.ndarray, valid: np.ndarray) -> float:
    """The largest absolute error of valid answers; infinite where one is no number."""
    worst = np.abs(np.where(valid, error, 0.0)).max(initial=0.0)
    return float(worst) if np.isfinite(worst) else float("inf")


def _taken(answer: Answer, order: np.ndarray) -> Answer:
    return Answer(answer.value[order], answer.sigma[order], answer.valid[order])


def _same(one: Answer, two: Answer) -> bool:
    return (
        np.array_equal(one.value, two.value, equal_nan=True)
        and np.array_equal(one.sigma, two.sigma, equal_nan=True)
        and np.array_equal(one.valid, two.valid)
    )


def _close(one: Answer, two: Answer) -> bool:
    """Whether the same elements are answered, with the same values but for rounding."""
    return np.array_equal(one.valid, two.valid) and np.allclose(
        np.where(one.valid, one.value, 0.0), np.where(two.valid, two.value, 0.0), rtol=ORDER_RTOL, atol=0.0
    )
