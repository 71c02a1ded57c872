"""Numbers as text that a person can use: significant digits, shares, times, counts, multiples."""

from __future__ import annotations

import math

__all__ = ["count_text", "number", "rate", "span", "time_text", "timed_text", "times_text"]

#: Multiples above this are told by their order alone: their digits say nothing.
_MOST_TIMES = 1e6
#: Half an interval over its value from which its ends are told in place of «±»: a time is not below zero.
_MOST_HALF = 0.5


def number(value: float, digits: int = 3) -> str:
    """A number with `digits` significant digits, without an exponent unless it is very small or large; a dash for NaN."""
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    if not -4 <= size < 6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - size)}f}"


def span(low: float, high: float) -> str:
    """` [low, high]`, or an empty text where an end is unknown."""
    return f" [{number(low)}, {number(high)}]" if math.isfinite(low) and math.isfinite(high) else ""


def rate(value: float) -> str:
    """A share in per cent. A share below one is never rounded to 100 %, nor one above zero to 0 %."""
    if not math.isfinite(value):
        return "–"
    text = f"{100 * value:.1f}"
    if text == "100.0":
        return "100 %" if value >= 1 else "> 99.9 %"
    if text == "0.0":
        return "0 %" if value <= 0 else "< 0.1 %"
    return f"{text} %"


def time_text(seconds: float) -> str:
    """A time in a suitable unit, ns to s."""
    if not (math.isfinite(seconds) and seconds > 0):
        return "–"
    for factor, unit in ((1e9, "ns"), (1e6, "µs"), (1e3, "ms")):
        if seconds * factor < 1000:
            return f"{number(seconds * factor)} {unit}"
    return f"{number(seconds)} s"


def timed_text(seconds: float, low: float, high: float) -> str:
    """A time and its interval: `2.60 µs ± 1.2 %`, and `2.60 µs, between 100 ns and 70.0 µs` where that is wide or lopsided."""
    half = 0.5 * (high - low) / seconds if seconds > 0 else math.nan
    if not math.isfinite(half):
        return time_text(seconds)
    if half < _MOST_HALF:
        return f"{time_text(seconds)} ± {rate(half)}"
    return f"{time_text(seconds)}, " + (
        f"between {time_text(low)} and {time_text(high)}" if low > 0 else f"at most {time_text(high)}"
    )


def times_text(ratio: float) -> str:
    """A multiple: `1.20`, `345`, `12,300`; `over a million` above that."""
    if not ratio <= _MOST_TIMES:
        return "over a million" if ratio > _MOST_TIMES else "–"
    return f"{float(f'{ratio:.3g}'):,.0f}" if ratio >= 1000.0 else number(ratio)


def count_text(count: float) -> str:
    """A number of elements: `1,200`; from a million on `9.00 M`."""
    return f"{count / 1e6:.2f} M" if count >= 999_999.5 else f"{count:,.0f}"
