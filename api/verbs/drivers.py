"""`beambench drivers list`: the drivers of devices, and what each needs."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..captures.drivers.listing import Driver

__all__ = ["drivers_list"]


def drivers_list() -> list[Driver]:
    """List the drivers of cameras, delay generators and oscilloscopes: what is installed, and how to get the rest.

    Returns:
        One record per driver: `name`, `role`, `what`, `tried` (on what it was tried), `needs`, `how`, `there`.
    """
    from ..captures.drivers.listing import DRIVERS

    return list(DRIVERS.values())
