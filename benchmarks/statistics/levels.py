"""How the levels of a stress are spaced."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["is_log"]

#: Levels that span a factor of at least this lie on a logarithmic axis.
_LOG_FACTOR = 8.0


def is_log(levels: Sequence[float]) -> bool:
    """Whether levels are halved as ratios: all above zero, and spanning a factor of 8 or more."""
    return min(levels) > 0 and max(levels) / min(levels) >= _LOG_FACTOR
