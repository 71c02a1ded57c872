"""The environment variables of a child."""

from __future__ import annotations

import os
import sys

from ...optics.jit import GIVEN_HASH, source_hash
from .protocol import THREAD_VARIABLES

__all__ = ["TOKEN", "child_environment"]

#: Variable by which the descendants of a child are known.
TOKEN = "BEAMBENCH_CHILD"


def child_environment() -> dict[str, str]:
    """The parent's environment and import path, with one thread for every library and reproducible hashes."""
    environment = dict(os.environ)
    environment.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    # The child starts in an empty folder, but can import everything that the parent can.
    environment["PYTHONPATH"] = os.pathsep.join(path or os.getcwd() for path in sys.path)
    environment["PYTHONHASHSEED"] = "0"
    environment[GIVEN_HASH] = source_hash()
    environment.pop("PYTHONSTARTUP", None)
    return environment
