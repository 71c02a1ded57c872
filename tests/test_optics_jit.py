"""The cache of compiled kernels: a damaged file is noticed and compiled anew, whatever the damage."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from beambench.optics.jit import damaged_files

MODULE = """
from beambench.optics.jit import kernel

@kernel
def inner(x):
    return 3.0 * x

@kernel(fastmath=True)
def outer(x):
    return inner(x) + 1.0

if __name__ == "__main__":
    hits = outer(2.0)
    print(hits, sum(outer.stats.cache_hits.values()))
"""


def call(folder: Path) -> list[str]:
    """Value of the kernel and whether it came from the cache, in a process of its own."""
    (folder / "tiny.py").write_text(MODULE)
    environment = os.environ | {"XDG_CACHE_HOME": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, str(folder / "tiny.py")], capture_output=True, text=True, env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("jit")
    assert call(folder) == ["7.0", "0"]
    assert call(folder) == ["7.0", "1"]
    return folder


def damages(content: bytes) -> dict[str, bytes]:
    middle = len(content) // 2
    flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    return {
        "empty": b"",
        "cut": content[:middle],
        "flipped": flipped,
        "longer": content + b"x",
        "zeros": bytes(len(content)),
    }


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "longer", "zeros"])
def test_a_damaged_file_is_compiled_anew(filled: Path, suffix: str, damage: str) -> None:
    """An empty index was EOFError for ever after; a flipped bit in the machine code would run as it is."""
    cache = filled / "cache"
    files = [path for path in sorted(cache.rglob(f"*{suffix}")) if "outer" in path.name]
    assert files
    for path in files:
        path.write_bytes(damages(path.read_bytes())[damage])
    assert damaged_files(cache) == files
    assert call(filled) == ["7.0", "0"]
    assert damaged_files(cache) == []
    assert call(filled) == ["7.0", "1"]
