"""The laws of an estimator, by its label or as a function."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module

from ...captures.layouts import stage_of
from ...captures.quantities import Stage
from ...estimators import get_estimator, parse_label
from ...estimators.labels import check_parameters
from ...scenes.errors import InputError
from ..judges import JUDGES, judge_of
from ..runner.estimator_labels import check_estimators
from .maker import Laws, Maker, Run
from .suite import LawResult, Report, judged, named

__all__ = ["check_laws", "laws_of", "maker_of"]


def check_laws(run: Run, stage: str, report: Report | None = None) -> list[LawResult]:
    """Hold an estimator, given as a function of a capture, to every law.

    Main arguments:
        stage: the word under `@estimator`.
    Other arguments:
        report: as in `judged`.

    Raises InputError for a stage that has no laws.
    """
    return judged(named(run, Maker(_laws(stage_of(stage)), stage_of(stage))), report)


def laws_of(label: str) -> tuple[list[str], Callable[[Report | None], list[LawResult]]]:
    """The names of an estimator's laws, and the function that tries them. Imports the estimator.

    Main arguments:
        label: `name` or `name[key=value,...]`.

    Raises InputError for an unknown estimator, a bad parameter, or a stage that has no laws.
    """
    (chosen,) = check_estimators([label])
    name, params = parse_label(chosen.label)
    found = get_estimator(name)
    run = partial(found.function, **check_parameters(found.function, params, where=name))
    laws = named(run, Maker(_laws(found.stage), found.stage, found.unfit))
    return list(laws), lambda report: judged(laws, report)


def maker_of(stage: str) -> Maker:
    """The captures that the laws of a stage run on. Raises InputError for a stage that has no laws."""
    return Maker(_laws(stage_of(stage)), stage_of(stage))


def _laws(stage: Stage) -> Laws:
    place = judge_of(stage.modality).laws if stage.reads_captures and stage.modality in JUDGES else ""
    if not place:
        raise InputError(
            "There are no laws for this stage.", where=f"stage {stage.word}", value=stage.modality,
            allowed="a stage that reads captures of " + ", ".join(name for name in JUDGES if judge_of(name).laws),
        )  # fmt: skip
    module, _, name = place.partition(":")
    laws: Laws = getattr(import_module(module), name)
    return laws
