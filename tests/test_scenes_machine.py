"""Limits of control groups, version 2 and 1, in folders as Linux shows them."""

from __future__ import annotations

import os
from pathlib import Path

import psutil
import pytest

from beambench.scenes import machine

GIB = 2**30


@pytest.fixture
def groups(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty tree of control groups, of a process that belongs to none, on a machine of 64 processors and 64 GiB."""
    monkeypatch.setattr(machine, "GROUPS", tmp_path / "cgroup")
    monkeypatch.setattr(machine, "OWN", tmp_path / "own")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(64)), raising=False)
    memory = psutil.virtual_memory()._replace(total=64 * GIB, available=60 * GIB)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)
    (tmp_path / "cgroup").mkdir()
    return tmp_path


def put(groups: Path, name: str, text: str) -> None:
    file = groups / "cgroup" / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)


def test_without_control_groups_the_machine_is_the_limit(groups: Path) -> None:
    assert (machine.usable_cores(), machine.memory_bytes(), machine.free_bytes()) == (64, 64 * GIB, 60 * GIB)


@pytest.mark.parametrize(
    ("quota", "cores"), [("max 100000", 64), ("50000 100000", 1), ("370000 100000", 3), ("9900000 100000", 64)]
)
def test_a_quota_of_version_2(groups: Path, quota: str, cores: int) -> None:
    (groups / "own").write_text("0::/a/b\n")
    put(groups, "a/b/cpu.max", quota + "\n")
    assert machine.usable_cores() == cores


def test_the_least_limit_of_the_groups_above_counts(groups: Path) -> None:
    """A container's own group may be free, and the pod's be limited."""
    (groups / "own").write_text("0::/pod/one\n")
    put(groups, "pod/one/cpu.max", "max 100000\n")
    put(groups, "pod/cpu.max", "200000 100000\n")
    put(groups, "pod/one/memory.max", "max\n")
    put(groups, "pod/memory.max", f"{4 * GIB}\n")
    put(groups, "pod/memory.current", f"{3 * GIB}\n")
    assert machine.usable_cores() == 2
    assert (machine.memory_bytes(), machine.free_bytes()) == (4 * GIB, GIB)


def test_in_a_namespace_the_limits_lie_at_the_root(groups: Path) -> None:
    (groups / "own").write_text("0::/\n")
    put(groups, "cpu.max", "100000 100000\n")
    put(groups, "memory.max", f"{2 * GIB}\n")
    put(groups, "memory.current", f"{3 * GIB}\n")
    assert (machine.usable_cores(), machine.memory_bytes(), machine.free_bytes()) == (1, 2 * GIB, 0)


def test_limits_of_version_1(groups: Path) -> None:
    (groups / "own").write_text("5:memory:/job\n4:cpu,cpuacct:/job\n0::/\n")
    put(groups, "cpu/cpu.cfs_quota_us", "-1\n")
    put(groups, "cpu/cpu.cfs_period_us", "100000\n")
    put(groups, "cpu/job/cpu.cfs_quota_us", "300000\n")
    put(groups, "cpu/job/cpu.cfs_period_us", "100000\n")
    put(groups, "memory/memory.limit_in_bytes", "9223372036854771712\n")
    put(groups, "memory/job/memory.limit_in_bytes", f"{8 * GIB}\n")
    put(groups, "memory/job/memory.usage_in_bytes", f"{GIB}\n")
    assert machine.usable_cores() == 3
    assert (machine.memory_bytes(), machine.free_bytes()) == (8 * GIB, 7 * GIB)


def test_what_cannot_be_read_is_no_limit(groups: Path) -> None:
    (groups / "own").write_text("nonsense\n")
    put(groups, "cpu.max", "\n")
    put(groups, "memory.max", "much\n")
    assert (machine.usable_cores(), machine.memory_bytes()) == (64, 64 * GIB)
