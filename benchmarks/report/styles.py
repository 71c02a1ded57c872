"""The colour and the mark of every estimator of a run: the same in all charts, tables and legends of its page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

__all__ = ["PALETTE", "SHAPES", "Style", "styles_of"]

#: Okabe and Ito (2008), without black and yellow: distinguishable by the colour-blind, on white and on dark.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
#: Marks of Vega: with the six colours, 36 estimators differ, and no two of them by colour alone.
SHAPES = ("circle", "triangle-up", "square", "diamond", "cross", "triangle-down")

#: (colour, mark)
Style = tuple[str, str]


def styles_of(labels: Iterable[str]) -> Mapping[str, Style]:
    """Colour and mark by label. They depend on the set of labels only, not on their order, a scene or a result."""
    return {
        label: (PALETTE[i % len(PALETTE)], SHAPES[(i + i // len(PALETTE)) % len(SHAPES)])
        for i, label in enumerate(sorted(set(labels)))
    }
