"""Own namespaces for a child (Linux), and a supervisor that ends everything that the child started.

    supervised(own=True)   # returns in the worker only; the processes that started it wait, and end with its exit status

With namespaces the worker sees no process but its own descendants, has a /dev/shm of its own, an empty /run (without the sockets
of services), System V objects of its own, and no network: its first process is the `init` of a namespace of processes, and when
that ends, the kernel ends all that is left in there, whatever its session or its parent. Without them the supervisor is the reaper
of orphans (PR_SET_CHILD_SUBREAPER), so that none leaves its tree, and it kills what is left.

This file imports nothing of the package: `works` runs it as a script, to try whether this machine offers all of it.
Sources: unshare(2), user_namespaces(7), pid_namespaces(7), prctl(2).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from functools import lru_cache

__all__ = ["supervised", "works"]

#: CLONE_NEWUSER, NEWPID, NEWNS, NEWIPC, NEWNET.
_ALL = 0x10000000 | 0x20000000 | 0x00020000 | 0x08000000 | 0x40000000
_PRIVATE = 0x4000 | 0x40000  # MS_REC | MS_PRIVATE
_NO_PROGRAMS = 0x2 | 0x4 | 0x8  # MS_NOSUID | MS_NODEV | MS_NOEXEC
_DEATH_SIGNAL, _SUBREAPER = 1, 36  # PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER
_CAPABILITIES = 0x20080522  # _LINUX_CAPABILITY_VERSION_3
#: Longest time for which the supervisor kills what is left, s.
_END_S = 5.0


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _checked(result: int) -> None:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


@lru_cache(maxsize=1)
def works() -> bool:
    """Whether this user may have such namespaces on this machine, tried once in a process of its own."""
    if sys.platform != "linux":
        return False
    try:
        tried = subprocess.run(
            [sys.executable, "-I", "-S", __file__],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=20.0,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return False
    return tried.returncode == 0


def supervised(*, own: bool, close: tuple[int, ...] = ()) -> None:
    """Split this process: the worker returns, and the processes above it wait for it, end what it left, and end as it ended.

    Main arguments:
        own: whether the worker gets namespaces of its own.
    Other arguments:
        close: files that only the worker keeps open.

    Raises OSError, before any split, where the kernel refuses the namespaces.
    """
    if own:
        user, group = os.getuid(), os.getgid()
        _checked(_libc().unshare(_ALL))
        for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
                file.write(text)
    else:
        _libc().prctl(_SUBREAPER, 1, 0, 0, 0)
    if (first := os.fork()) == 0:
        _libc().prctl(_DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)
        if own:
            _inside(close)
        return
    for fd in close:
        os.close(fd)
    status = _wait_for(first)
    if not own:
        _end_the_rest()
    _end_as(status)


def _inside(close: tuple[int, ...]) -> None:
    """Give the namespace its /proc and /dev/shm, and split the worker from its `init`; returns in the worker only."""
    libc = _libc()
    _checked(libc.mount(b"none", b"/", None, _PRIVATE, None))
    _checked(libc.mount(b"proc", b"/proc", b"proc", _NO_PROGRAMS, None))
    if os.path.isdir("/dev/shm"):
        _checked(libc.mount(b"tmpfs", b"/dev/shm", b"tmpfs", _NO_PROGRAMS, b"size=256m"))
    if os.path.isdir("/run"):  # the sockets of services: to connect to one is no right of Landlock
        _checked(libc.mount(b"tmpfs", b"/run", b"tmpfs", _NO_PROGRAMS, b"size=64k"))
    if (worker := os.fork()) == 0:
        _libc().prctl(_DEATH_SIGNAL, int(signal.SIGKILL), 0, 0, 0)
        _drop_capabilities()
        return
    for fd in close:
        os.close(fd)
    status = _wait_for(worker)
    # `init` is immune to signals from inside: a signal that ended the worker is told as an exit code.
    os._exit(128 + os.WTERMSIG(status) if os.WIFSIGNALED(status) else min(os.WEXITSTATUS(status), 127))


def _drop_capabilities() -> None:
    """A worker has no privileges, not even in its namespace; programs that it starts get none back (no_new_privs)."""
    header = (ctypes.c_uint32 * 2)(_CAPABILITIES, 0)
    _checked(_libc().capset(header, (ctypes.c_uint32 * 6)()))


def _wait_for(worker: int) -> int:
    """Reap all that ends until the worker has ended; its status."""
    while True:
        try:
            pid, status = os.waitpid(-1, 0)
        except InterruptedError:
            continue
        if pid == worker:
            return status


def _end_the_rest() -> None:
    """Kill orphans, and those that they leave, until there are none."""
    until = time.monotonic() + _END_S
    while time.monotonic() < until:
        try:
            with open(f"/proc/self/task/{os.getpid()}/children", encoding="ascii") as file:
                left = [int(pid) for pid in file.read().split()]
        except OSError:
            left = []
        for pid in left:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        try:
            if os.waitpid(-1, os.WNOHANG) == (0, 0):
                time.sleep(0.001)
        except ChildProcessError:
            return


def _end_as(status: int) -> None:
    """End with the exit code, or by the signal, that ended the worker."""
    code = os.waitstatus_to_exitcode(status)
    number = -code if code < 0 else code - 128
    if code < 0 or (code > 128 and number in set(map(int, signal.Signals))):
        with contextlib.suppress(OSError):  # SIGKILL has no handler
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(code)


if __name__ == "__main__":
    supervised(own=True)
    # A worker that is in no namespace sees the processes of others.
    os._exit(0 if len([name for name in os.listdir("/proc") if name.isdigit()]) == 2 else 1)
