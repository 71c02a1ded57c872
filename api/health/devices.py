"""The drivers of devices: which can be used on this machine."""

from __future__ import annotations

from .finding import Finding

__all__ = ["drivers"]


def drivers() -> list[Finding]:
    """One record per driver; nothing is connected to."""
    from ..captures.drivers.listing import DRIVERS

    return [
        Finding(
            "drivers", one.name, "ok" if one.there else "missing", f"{one.what}; tried on: {one.tried}",
            "" if one.there else one.how,
        )
        for one in DRIVERS.values()
    ]  # fmt: skip
