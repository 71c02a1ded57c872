"""Layouts: the variables of each modality's captures, with dimensions, dtypes and units, and the estimated quantities."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..quantities import Stage
    from .layout import Layout

__all__ = ["LAYOUTS", "is_main_quantity", "layout_of", "scored_first", "stage_of", "stages"]

#: modality -> "module:object"
LAYOUTS: dict[str, str] = {
    "gated": "beambench.captures.layouts.gated:LAYOUT",
    "waveform": "beambench.captures.layouts.waveform:LAYOUT",
    "amcw": "beambench.captures.layouts.amcw:LAYOUT",
    "laser_line": "beambench.captures.layouts.laser_line:LAYOUT",
    "wavefront": "beambench.captures.layouts.wavefront:LAYOUT",
}


def layout_of(modality: object) -> Layout:
    """The layout of a modality. Raises InputError for an unknown one."""
    from ...scenes.records import record_of

    layout: Layout = record_of(LAYOUTS, modality, "There is no such modality.", "attribute modality")
    return layout


@lru_cache(maxsize=1)
def stages() -> dict[str, Stage]:
    """All stages, by their words (the argument of `@estimator`)."""
    return {stage.word: stage for modality in LAYOUTS for stage in layout_of(modality).stages}


def is_main_quantity(stage: str, quantity: str) -> bool:
    """Whether a quantity is the main one (the first) of a stage, as the tables' columns `stage` and `quantity` name them."""
    return any(one.name == stage and one.gives[0].name == quantity for one in stages().values())


def stage_of(word: object) -> Stage:
    """The stage that a word (the argument of `@estimator`) names. Raises InputError for an unknown one."""
    from ...scenes.errors import InputError
    from ...scenes.nearest import did_you_mean

    if not isinstance(word, str) or word not in stages():
        raise InputError(
            "There is no such stage.", where="stage", value=word, allowed=", ".join(stages()),
            next_step=did_you_mean(str(word), stages()),
        )  # fmt: skip
    return stages()[word]


def scored_first(modality: str, stage: str, quantity: str) -> bool:
    """Whether a row of a table, given by its modality, stage and quantity, is of the main quantity of its stage."""
    known = layout_of(modality).stages if modality in LAYOUTS else ()
    return any(one.name == stage and one.gives[0].name == quantity for one in known)
