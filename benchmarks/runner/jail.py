"""A jail for a child, by Landlock: it reads the programs of the machine and its own folders, writes its own, and nothing else.

    allowed = seal(read=[...], write=[...])   # of this process and all that it starts, for ever

Under the rules a process opens no file outside the given folders, so neither the truth, the results nor the memory of its
parent (/proc/PID of others) can be read; it opens no TCP connection; and it signals no process outside. Root is bound by it too.
System calls by number, as the C library has no wrappers: landlock(7), kernel 5.13 and newer.

What it does not stop: load on processor and memory, names in folders that may be listed, and, without namespaces, UDP and Unix
sockets with a name.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Iterable
from pathlib import Path

from .namespaces import works

__all__ = ["NO_JAIL", "OFF", "abi", "isolation", "jailed", "readable", "seal"]

_CREATE, _ADD, _RESTRICT = 444, 445, 446
_VERSION = 1  # LANDLOCK_CREATE_RULESET_VERSION
_PATH_BENEATH = 1  # LANDLOCK_RULE_PATH_BENEATH
_NO_NEW_PRIVS = 38  # PR_SET_NO_NEW_PRIVS

#: LANDLOCK_ACCESS_FS_*: execute, read a file, list a folder.
_READ = 1 << 0 | 1 << 2 | 1 << 3
_LIST = 1 << 3
_OF_DEVICES = 1 << 1 | 1 << 2 | 1 << 14
#: The accesses that a rule for a file, rather than a folder, may name: execute, write, read, truncate, ioctl of a device.
_OF_FILES = 1 << 0 | 1 << 1 | 1 << 2 | 1 << 14 | 1 << 15
#: Number of LANDLOCK_ACCESS_FS_* rights from each version of the ABI on.
_RIGHTS = ((5, 16), (3, 15), (2, 14), (1, 13))
_TCP = 0b11  # LANDLOCK_ACCESS_NET_BIND_TCP and CONNECT_TCP, from ABI 4
_SCOPES = 0b11  # LANDLOCK_SCOPE_ABSTRACT_UNIX_SOCKET and SIGNAL, from ABI 6

#: Name of this package.
_PACKAGE = __name__.split(".")[0]
#: Environment variable that, set to "none", runs estimators without a jail; a run then says so.
OFF = "BEAMBENCH_ISOLATION"
#: Folders of this package that a child may not open: with them a scene could be found by its rig and generated again.
_REFUSED = (("generator", ""), ("scenes", "library"), ("benchmarks", "suites/library"))
_ROOMS = ("optics", "scenes", "captures", "estimators", "benchmarks")
#: The system: programs, libraries, settings, and what tells the kind of processor.
_SYSTEM = (
    "/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/etc", "/opt", "/nix", "/gnu", "/sys/devices/system",
    "/sys/fs/cgroup", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/sys", "/proc/filesystems", "/proc/self",
)  # fmt: skip
_DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/urandom", "/dev/random", "/proc/self/clear_refs")


def _call(number: int, *arguments: object) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    result = int(libc.syscall(number, *arguments))
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result


def abi() -> int:
    """Version of the kernel's Landlock; 0 where there is none."""
    if sys.platform != "linux":
        return 0
    try:
        return _call(_CREATE, None, ctypes.c_size_t(0), ctypes.c_uint32(_VERSION))
    except OSError:
        return 0


#: What is told of a run without a jail.
NO_JAIL = (
    "estimators ran without Landlock, so a plug-in could have read the truth: their order is no ranking to publish"
)


def jailed() -> bool:
    """Whether estimators cannot read the files of their user here: what a published ranking needs."""
    return os.environ.get(OFF) != "none" and abi() > 0


def isolation() -> str:
    """One line for reports: which isolation of estimators is in force on this machine."""
    if os.environ.get(OFF) == "none":
        return f"processes only ({OFF}=none): a plug-in can read files, the network and other processes of its user"
    version = abi()
    spaces = "namespaces of processes, network, /dev/shm" if works() else ""
    if not version:
        if spaces:
            return f"{spaces}; no Landlock: a plug-in can read files of its user"
        return "processes only (no Landlock): a plug-in can read files, the network and other processes of its user"
    parts = ["files"]
    if version >= 4:
        parts.append("TCP")
    if version >= 6:
        parts += ["signals", "abstract sockets"]
    return f"Landlock {version}: {', '.join(parts)}" + (f"; {spaces}" if spaces else "; no namespaces")


def readable(hidden: Iterable[Path]) -> list[str]:
    """Folders and files that a child needs to import and compute, without the folders `hidden`, generators and libraries of scenes.

    The system, Python, the import path, and the rooms of this package. A folder that holds a hidden one is replaced by its
    other members.
    """
    import importlib.util

    rooms: dict[str, list[Path]] = {}
    for room in ("generator", *_ROOMS):
        spec = importlib.util.find_spec(f"{_PACKAGE}.{room}")
        rooms[room] = [Path(place).resolve() for place in (spec.submodule_search_locations or ())] if spec else []
    refused = {place / inner for room, inner in _REFUSED for place in rooms[room]}
    refused |= {path.resolve() for path in (*hidden, Path("beambench-runs"))}  # earlier runs hold truth
    roots = [Path(name) for name in (*_SYSTEM, sys.prefix, sys.base_prefix)]
    roots += [Path(name or os.getcwd()).resolve() for name in sys.path]
    front = importlib.util.find_spec(_PACKAGE)
    roots += [Path(place).resolve() for place in ((front and front.submodule_search_locations) or ())]
    roots += [place for room in _ROOMS for place in rooms[room]]
    roots += _editable()
    found: dict[str, None] = {}
    for root in roots:
        for path in _without(root, refused):
            found[str(path)] = None
    return list(found)


def _editable() -> list[Path]:
    """Places of packages that are installed as editable: their finders (setuptools) know folders outside the import path."""
    finders = [module for name, module in list(sys.modules.items()) if name.startswith("__editable__")]
    maps = [getattr(module, "MAPPING", None) for module in finders]
    places = [place for one in maps if isinstance(one, dict) for place in one.values() if isinstance(place, str)]
    return [Path(name) for place in places for name in (place, f"{place}.py") if os.path.exists(name)]


def _without(path: Path, refused: set[Path]) -> Iterable[Path]:
    """`path`, or its members where a refused folder lies beneath it; nothing where it lies in a refused folder."""
    if path in refused or not refused.isdisjoint(path.parents):
        return
    if not any(path in other.parents for other in refused):
        yield path
    elif path.is_dir() and not path.is_symlink():
        for member in sorted(path.iterdir()):
            yield from _without(member, refused)


def seal(*, read: Iterable[str], write: Iterable[str]) -> int:
    """Restrict this process and its descendants, and return the version of Landlock in force; 0 where there is none.

    Main arguments:
        read: folders and files that it may read and execute. write: folders in which it may do everything.

    A path that does not exist is left out. Raises OSError where the kernel has Landlock and refuses the rules.
    """
    version = abi()
    if not version:
        return 0
    every = (1 << next(count for least, count in _RIGHTS if version >= least)) - 1
    fields = [every, *([_TCP] if version >= 4 else []), *([_SCOPES] if version >= 6 else [])]
    attributes = struct.pack(f"={len(fields)}Q", *fields)
    ruleset = _call(_CREATE, attributes, ctypes.c_size_t(len(attributes)), ctypes.c_uint32(0))
    try:
        # Names may be listed everywhere below the root, as an import lists its folders; only files are kept from it.
        everywhere = ((("/",), _LIST), (read, _READ), (_DEVICES, _OF_DEVICES & every), (write, every))
        for paths, access in everywhere:
            for path in paths:
                _allow(ruleset, path, access)
        if ctypes.CDLL(None).prctl(_NO_NEW_PRIVS, 1, 0, 0, 0):
            raise OSError("no_new_privs is refused")
        _call(_RESTRICT, ctypes.c_int(ruleset), ctypes.c_uint32(0))
    finally:
        os.close(ruleset)
    return version


def _allow(ruleset: int, path: str, access: int) -> None:
    try:
        handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        if not os.path.isdir(path):
            access &= _OF_FILES
        rule = struct.pack("=Qi", access, handle)
        _call(_ADD, ctypes.c_int(ruleset), ctypes.c_int(_PATH_BENEATH), rule, ctypes.c_uint32(0))
    finally:
        os.close(handle)
