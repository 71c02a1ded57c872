"""What is found in a recording itself when it is imported: name -> "module:function"."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from ...scenes.errors import InputError

__all__ = ["REGISTRATIONS", "registration_of"]

#: Each takes (data, coordinates, rig, parameters), and returns (data, rig).
REGISTRATIONS: dict[str, str] = {
    "lenslets": "beambench.estimators.wavefront.register:lenslets_of_reference",
    "response": "beambench.estimators.waveform.register:response_of_records",
}


def registration_of(name: str) -> Callable[..., tuple[dict[str, Any], dict[str, Any]]]:
    """The function of a name. Raises InputError for an unknown one."""
    if name not in REGISTRATIONS:
        raise InputError(
            "There is no such registration.", where="rig.register", value=name, allowed=", ".join(REGISTRATIONS)
        )
    module, _, function = REGISTRATIONS[name].partition(":")
    found: Callable[..., tuple[dict[str, Any], dict[str, Any]]] = getattr(import_module(module), function)
    return found
