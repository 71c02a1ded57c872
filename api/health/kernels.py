"""Compiled kernels: their cache, the threads they run on, and what the environment changes of both."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

from ..scenes.machine import usable_cores
from .finding import Finding

__all__ = ["environment", "kernel_cache", "threads"]

_PROBE = """
import json, sys
import numba, numpy as np
@numba.njit(parallel=True)
def total(x):
    s = 0.0
    for i in numba.prange(x.size):
        s += x[i]
    return s
assert total(np.ones(1000)) == 1000.0
print("\\n" + json.dumps({"layer": numba.threading_layer(), "threads": numba.get_num_threads()}))
"""

#: Variables that change how kernels run, and what each does.
_CHANGES = {
    "NUMBA_DISABLE_JIT": "kernels are not compiled: a hundred times slower",
    "NUMBA_BOUNDSCHECK": "kernels check every index: several times slower",
    "NUMBA_DEBUG": "kernels are compiled without optimisation",
    "NUMBA_OPT": "kernels are compiled with another optimisation",
    "NUMBA_THREADING_LAYER": "kernels run on another threading layer",
    "NUMBA_CPU_NAME": "kernels are compiled for another processor",
    "NUMBA_CPU_FEATURES": "kernels are compiled for another processor",
    "OMP_WAIT_POLICY": "threads that spin while they wait slow the renderer",
    "PYTHONOPTIMIZE": "checks inside Python code are left out",
    "LD_PRELOAD": "a library is loaded before all others",
}
_COUNTS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")


def kernel_cache() -> Finding:
    """The folder of compiled kernels, and whether each file is as it was written."""
    from ..optics.jit import cache_folder, damaged_files

    folder = cache_folder()
    # If the user's cache cannot be written, a temporary folder is used: kernels are compiled again in every process.
    lasting = not folder.name.startswith("beambench-numba-")
    free = f"{shutil.disk_usage(folder).free / 2**30:.1f} GiB free"
    damaged = damaged_files(folder)
    if damaged:
        names = ", ".join(path.name for path in damaged[:3]) + (" …" if len(damaged) > 3 else "")
        text = f"{folder}: {len(damaged)} damaged files ({names}); {free}"
        return Finding("caches", "numba", "warning", text, "nothing: they are compiled anew when they are needed")
    if not lasting:
        advice = "set XDG_CACHE_HOME to a writable folder; otherwise kernels are compiled in every process"
        return Finding("caches", "numba", "warning", f"{folder}: {free}", advice)
    return Finding("caches", "numba", "ok", f"{folder}: {free}; every file is whole")


def threads() -> Finding:
    """The threading layer of parallel kernels, tried in a child process."""
    try:
        done = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=180, check=False)
    except subprocess.TimeoutExpired:
        text = "A parallel kernel did not end within 180 s."
        return Finding(
            "kernels", "threads", "broken", text, "unset NUMBA_THREADING_LAYER; run `beambench doctor` again"
        )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        text = f"A parallel kernel ended with exit code {done.returncode}: {last}"
        return Finding(
            "kernels", "threads", "broken", text, "unset NUMBA_THREADING_LAYER; pip install --force-reinstall numba"
        )
    told = json.loads(done.stdout.strip().splitlines()[-1])
    # OpenMP of GNU ends every process that was forked after its first use; the workqueue may not be used by two threads at once.
    text = f"{told['layer']}, {told['threads']} threads; pools of processes must be started by spawn, not fork"
    return Finding("kernels", "threads", "ok", text)


def environment() -> list[Finding]:
    """One record for each variable that is set and changes how kernels run; one if none is."""
    found = []
    for name, effect in _CHANGES.items():
        value = os.environ.get(name, "")
        if value and not (name == "OMP_WAIT_POLICY" and value.upper() == "PASSIVE"):
            found.append(Finding("environment", name, "warning", f"{value}: {effect}", f"unset {name}"))
    cores = usable_cores()
    for name in _COUNTS:
        value = os.environ.get(name, "")
        if value and not (value.isdigit() and 1 <= int(value[:9]) <= cores):
            text = f"{value}: this process may use {cores} cores"
            found.append(Finding("environment", name, "warning", text, f"unset {name}, or set it to 1 … {cores}"))
    return found or [Finding("environment", "variables", "ok", "none that changes how kernels run")]
