"""Processes that were forked after use: their threads are gone, and what waits for them waits for ever.

The renderer and OpenMP start threads at their first use, and a fork copies none. In a pool of processes made by fork the
workers then hang, or die and are started again for ever. A forked process knows it here, and says so at once.
"""

from __future__ import annotations

import os
import sys

from .errors import InputError

__all__ = ["refuse_forked"]

_FORKED: list[str] = []


def refuse_forked() -> None:
    """Raise InputError in a process that was forked after the renderer or parallel code had been used in its parent."""
    if _FORKED:
        raise InputError(
            "This process was forked after Beambench had been used: the threads that it needs were not copied.",
            where="multiprocessing",
            value=f"fork, after use of {' and '.join(_FORKED)}",
            allowed="processes started by spawn or forkserver, or forked before the first use",
            next_step='multiprocessing.get_context("spawn").Pool(...)',
        )


def _in_child() -> None:
    _FORKED.clear()
    if "drjit" in sys.modules:
        _FORKED.append("the renderer")
    if getattr(sys.modules.get("numba.np.ufunc.parallel"), "_is_initialized", False):
        _FORKED.append("parallel code")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)
