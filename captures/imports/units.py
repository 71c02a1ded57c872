"""Units of what is imported: a factor to the SI unit that a capture has."""

from __future__ import annotations

from ...scenes.errors import InputError

__all__ = ["UNITS", "factor"]

#: Unit -> (the unit of captures, factor).
UNITS: dict[str, tuple[str, float]] = {
    **{name: ("s", value) for name, value in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9), ("ps", 1e-12))},
    **{name: ("m", value) for name, value in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6), ("µm", 1e-6), ("nm", 1e-9))},
    **{name: ("rad", value) for name, value in (("rad", 1.0), ("mrad", 1e-3), ("urad", 1e-6), ("deg", 0.017453292519943295))},
    **{name: ("V", value) for name, value in (("V", 1.0), ("mV", 1e-3))},
    **{name: ("A", value) for name, value in (("A", 1.0), ("mA", 1e-3), ("uA", 1e-6))},
    **{name: (name, 1.0) for name in ("DN", "electron", "px", "1", "Hz", "W", "dB", "m, rad")},
}  # fmt: skip


def factor(given: str, allowed: tuple[str, ...], where: str) -> tuple[str, float]:
    """(unit in the capture, factor) of a given unit. Raises InputError for one that is missing, unknown or of another kind."""
    if given in UNITS and UNITS[given][0] in allowed:
        return UNITS[given]
    fitting = ", ".join(name for name, (unit, _) in UNITS.items() if unit in allowed)
    raise InputError(
        "The unit is not declared." if not given else "The unit does not fit the variable.", where=f"{where}.units",
        value=given or None, allowed=fitting or ", ".join(allowed),
    )  # fmt: skip
