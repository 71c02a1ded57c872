"""`beambench doctor`: what works on this machine, what is missing, and how to install it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..health.finding import Finding

__all__ = ["doctor"]


def doctor() -> list[Finding]:
    """Show what works on this machine, what is missing, and how to install it; the exit code is 1 if a required part is broken.

    Python, packages, renderer, modalities, kernels with their cache and environment, extras, drivers of devices,
    the isolation of estimators and disks are examined; nothing is changed or downloaded.

    Returns:
        One record per part: `group`, `name`, `state` ("ok", "missing", "warning" or "broken"), `found`, `advice`.
    """
    from ..health.devices import drivers
    from ..health.kernels import environment, kernel_cache, threads
    from ..health.machine import disks, jail, python
    from ..health.modalities import modalities
    from ..health.packages import extras, packages
    from ..health.rendering import cuda, renderer

    kernels = [threads(), kernel_cache(), *environment()]
    return [
        *python(),
        *packages(),
        renderer(),
        cuda(),
        *modalities(),
        *kernels,
        *extras(),
        *drivers(),
        jail(),
        *disks(),
    ]
