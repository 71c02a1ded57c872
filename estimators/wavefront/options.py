"""Options of estimators within their limits: a value outside them is refused, never replaced by another."""

from __future__ import annotations

import math

from ...scenes.errors import InputError

__all__ = ["in_range", "whole"]


def in_range(name: str, value: float, least: float, below: float = math.inf, *, above: bool = False) -> float:
    """`value`, where it is a number from `least` (with `above`: greater than it) to less than `below`.

    Raises:
        InputError: it is not.
    """
    number = float(value)
    if (number > least if above else number >= least) and number < below:
        return number
    limit = f"greater than {least:g}" if above else f"{least:g} or more"
    raise InputError(
        f"The option {name} is outside its limits.", where=name, value=value,
        allowed=limit + (f", less than {below:g}" if math.isfinite(below) else ", finite"),
        next_step=f"leave {name} out for its default (beambench estimators list)",
    )  # fmt: skip


def whole(name: str, value: float, least: int) -> int:
    """`value`, where it is a whole number of at least `least`.

    Raises:
        InputError: it is not.
    """
    number = in_range(name, value, least)
    if number != int(number):
        raise InputError(f"The option {name} counts.", where=name, value=value, allowed=f"whole numbers from {least}",
                         next_step=f"give {name}={math.ceil(number)}")  # fmt: skip
    return int(number)
