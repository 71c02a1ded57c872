"""The environment variables of a child, and a process of this package that works beside the runner under them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence

from ...optics.jit import GIVEN_HASH, source_hash
from .protocol import THREAD_VARIABLES

__all__ = ["TOKEN", "child_environment", "start_beside"]

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


def start_beside(
    module: str, arguments: Sequence[str], environment: Mapping[str, str], *, pass_fds: Sequence[int] = ()
) -> subprocess.Popen[bytes]:
    """Start a module of this package in a session of its own, silent and in no folder of the user. Raises OSError."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", f"beambench.benchmarks.{module}", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=pass_fds,
        start_new_session=True,
        cwd="/",
        env=environment,
    )
