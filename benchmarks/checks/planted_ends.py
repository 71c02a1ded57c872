"""Hostile plug-ins that end, stop or fill their process and those beside it. `plugins` runs each beside an honest estimator."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from .gated_cheats import answer, planted

__all__: list[str] = []

#: How long a process that is left behind would stay, s.
_LONG_S = 600


# ---------------------------------------------------------------- ends


@planted
def exits(capture: xr.Dataset) -> Any:
    """End by sys.exit(0)."""
    sys.exit(0)


@planted
def exits_at_once(capture: xr.Dataset) -> Any:
    """End by os._exit(0), as if all were done."""
    os._exit(0)


@planted
def exits_as_the_house(capture: xr.Dataset) -> Any:
    """End with 70, the code of an error of this package."""
    os._exit(70)


@planted
def aborts(capture: xr.Dataset) -> Any:
    """Abort."""
    os.abort()


@planted
def reads_address_zero(capture: xr.Dataset) -> Any:
    """Read memory at address 0."""
    return ctypes.string_at(0)


@planted
def kills_itself(capture: xr.Dataset) -> Any:
    """Send itself SIGKILL."""
    os.kill(os.getpid(), signal.SIGKILL)


@planted
def terminates_itself(capture: xr.Dataset) -> Any:
    """Send itself SIGTERM."""
    os.kill(os.getpid(), signal.SIGTERM)
    return answer(capture)


@planted
def kills_its_group(capture: xr.Dataset) -> Any:
    """Send SIGKILL to its process group."""
    os.killpg(0, signal.SIGKILL)


@planted
def kills_its_parent(capture: xr.Dataset) -> Any:
    """Send SIGKILL to its parent."""
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(1.0)
    return answer(capture)


@planted
def becomes_another(capture: xr.Dataset) -> Any:
    """Become another program (exec) that does nothing."""
    os.execv(sys.executable, [sys.executable, "-S", "-c", "pass"])


@planted
def becomes_a_liar(capture: xr.Dataset) -> Any:
    """Become another program that keeps the pipes and says that the call is over."""
    for number in range(3, 64):
        with contextlib.suppress(OSError):
            os.set_inheritable(number, True)
    code = f'import os, time; os.write({int(sys.argv[3])}, b\'{{"event": "called"}}\\n\'); time.sleep({_LONG_S})'
    os.execv(sys.executable, [sys.executable, "-S", "-c", code])


# ---------------------------------------------------------------- hangs


@planted
def sleeps(capture: xr.Dataset) -> Any:
    """Sleep."""
    time.sleep(_LONG_S)


@planted
def spins(capture: xr.Dataset) -> Any:
    """Compute without an end."""
    while True:
        pass


@planted
def stops_itself(capture: xr.Dataset) -> Any:
    """Stop itself (SIGSTOP)."""
    os.kill(os.getpid(), signal.SIGSTOP)
    time.sleep(_LONG_S)


@planted
def hangs_deaf(capture: xr.Dataset) -> Any:
    """Sleep with all signals blocked."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    time.sleep(_LONG_S)


@planted
def waits_for_itself(capture: xr.Dataset) -> Any:
    """Wait for a lock that it holds."""
    lock = threading.Lock()
    with lock:
        lock.acquire()


# ---------------------------------------------------------------- memory, processes, threads, files


@planted
def takes_memory(capture: xr.Dataset) -> Any:
    """Take memory without an end."""
    held = []
    while True:
        held.append(np.ones(2**21))
        time.sleep(0.005)


@planted
def takes_memory_elsewhere(capture: xr.Dataset) -> Any:
    """Take memory in a process of a session of its own."""
    code = "import time\nx = []\nwhile True:\n    x.append(bytearray(b'x') * 2**24)\n    time.sleep(.005)"
    subprocess.run([sys.executable, "-S", "-c", code], start_new_session=True, check=False)


@planted
def takes_memory_at_once(capture: xr.Dataset) -> Any:
    """Ask for 8 TB at once."""
    return np.ones(2**40)


@planted
def forks(capture: xr.Dataset) -> Any:
    """Leave 60 processes, each of which sleeps."""
    for _ in range(60):
        if os.fork() == 0:
            time.sleep(_LONG_S)
    return answer(capture)


@planted
def returns_twice(capture: xr.Dataset) -> Any:
    """Fork, and return in both processes: two children speak on one pipe."""
    os.fork()
    return answer(capture)


@planted
def forks_in_a_chain(capture: xr.Dataset) -> Any:
    """Leave a process that forks and ends, again and again, so that its number is another each time."""
    if os.fork() == 0:
        for _ in range(2000):
            if os.fork():
                os._exit(0)
            os.setsid()
            time.sleep(0.01)
        os._exit(0)
    return answer(capture)


@planted
def threads_left(capture: xr.Dataset) -> Any:
    """Leave 100 threads that are no daemons."""
    for _ in range(100):
        threading.Thread(target=time.sleep, args=(_LONG_S,)).start()
    return answer(capture)


@planted
def thread_that_writes(capture: xr.Dataset) -> Any:
    """Leave a thread that tells events between the runner's orders."""

    def tell() -> None:
        while True:
            with contextlib.suppress(OSError):
                os.write(int(sys.argv[3]), b'{"event": "done"}\n')
            time.sleep(0.001)

    threading.Thread(target=tell, daemon=True).start()
    return answer(capture)


@planted
def opens_all_files(capture: xr.Dataset) -> Any:
    """Open files until none is left."""
    held = []
    with contextlib.suppress(OSError):
        while True:
            held.append(os.open(os.devnull, os.O_RDONLY))
    return answer(capture)


@planted
def fills_its_folder(capture: xr.Dataset) -> Any:
    """Leave 20,000 files and 64 MB in its temporary folder."""
    place = Path(os.environ["TMPDIR"])
    (place / "large").write_bytes(bytes(2**26))
    for number in range(20_000):
        os.close(os.open(place / str(number), os.O_CREAT, 0))
    return answer(capture)


@planted
def deep_folders(capture: xr.Dataset) -> Any:
    """Leave folders in folders, 1,500 deep, the last of which nobody may read."""
    os.chdir(os.environ["TMPDIR"])
    for _ in range(1500):
        os.mkdir("d")
        os.chdir("d")
    os.chmod(".", 0)
    return answer(capture)


@planted
def links_out(capture: xr.Dataset) -> Any:
    """Leave links to folders that are not its own where the runner will clean up."""
    for number, target in enumerate((os.path.expanduser("~"), "/tmp", "/etc")):
        os.symlink(target, Path(os.environ["TMPDIR"], f"link-{number}"))
    return answer(capture)
