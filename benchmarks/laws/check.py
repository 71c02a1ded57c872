"""The laws of an estimator, by its label or as a function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ...captures.layouts import stage_of
from ...captures.quantities import Stage
from ...estimators import get_estimator, parse_label
from ...estimators.labels import LINK, check_parameters
from ...scenes.errors import InputError
from ...scenes.records import object_at
from ..folders.progress import Progress
from ..judges import JUDGES, judge_of
from ..runner.estimator_labels import check_estimators
from .maker import Laws, Maker, Run
from .place import Place
from .suite import LawResult, Report, judged, named

__all__ = ["Check", "check_laws", "fed", "laws_of", "laws_record", "maker_of", "own_laws"]


@dataclass(frozen=True)
class Check:
    """What `estimators check` found: the laws, and the place among the built-in estimators, None where it was not asked for."""

    laws: list[LawResult]
    place: Place | None

    @property
    def ok(self) -> bool:
        """Whether every law holds."""
        return all(result.holds for result in self.laws)


def fed(name: str) -> str:
    """The name of an estimator, or of the chain that feeds it where it reads the results of another stage.

    Raises InputError for an unknown estimator, or for a stage that its modality names no feeder of.
    """
    found = get_estimator(name)
    if found.reads_captures:
        return name
    feeders = judge_of(found.modality).feeders
    if found.stage.word not in feeders:
        raise InputError(
            "Nothing is known that gives the input of this stage.", where=f"stage {found.stage.word}", value=name,
            allowed=", ".join(feeders) or "a stage that reads captures",
        )  # fmt: skip
    return f"{feeders[found.stage.word]}{LINK}{name}"


def check_laws(run: Run, stage: str, report: Report | None = None) -> list[LawResult]:
    """Hold an estimator, given as a function of a capture, to every law.

    Main arguments:
        stage: the word under `@estimator`.
    Other arguments:
        report: as in `judged`.

    Raises InputError for a stage that has no laws.
    """
    return judged(named(run, Maker(laws_record(stage_of(stage)), stage_of(stage))), report)


def laws_of(label: str) -> tuple[list[str], Callable[[Report | None], list[LawResult]]]:
    """The names of an estimator's laws, and the function that tries them. Imports the estimator.

    Main arguments:
        label: `name` or `name[key=value,...]`.

    Raises InputError for an unknown estimator, a bad parameter, or a stage that has no laws.
    """
    (chosen,) = check_estimators([label])
    name, params = parse_label(chosen.label)
    found = get_estimator(fed(name))
    run = partial(found.function, **check_parameters(found.function, params, where=name))
    laws = named(run, Maker(laws_record(found.stage), found.stage, found.unfit, joint=found.joint))
    return list(laws), lambda report: judged(laws, report)


def own_laws(label: str, progress: Progress) -> list[LawResult]:
    """The laws of a built-in estimator, by its label, each told as it begins. Raises InputError as `laws_of`."""
    names, judge = laws_of(label)

    def tell(name: str, result: LawResult | None) -> bool:
        if result is None:
            progress("laws", names.index(name), len(names), name)
        elif name == names[-1]:
            progress("laws", len(names), len(names), "")
        return True

    return judge(tell)


def maker_of(stage: str) -> Maker:
    """The captures that the laws of a stage run on. Raises InputError for a stage that has no laws."""
    return Maker(laws_record(stage_of(stage)), stage_of(stage))


def laws_record(stage: Stage) -> Laws:
    """What the modality of a stage contributes to the laws. Raises InputError for a stage that has no laws."""
    judge = judge_of(stage.modality) if stage.modality in JUDGES else None
    tried = judge is not None and (stage.reads_captures or stage.word in judge.feeders)
    place = judge.laws if judge is not None and tried else ""
    if not place:
        raise InputError(
            "There are no laws for this stage.", where=f"stage {stage.word}", value=stage.modality,
            allowed="a stage that reads captures of " + ", ".join(name for name in JUDGES if judge_of(name).laws),
        )  # fmt: skip
    laws: Laws = object_at(place)
    return laws
