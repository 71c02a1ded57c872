"""A read-only source tree and a user without a home: kernels still compile, and their cache goes elsewhere."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

FLOORS = ("optics", "scenes", "captures", "generator", "estimators", "benchmarks")
PROBE = '''
"""A kernel as any module of the project holds it."""
import json, os
from pathlib import Path
from beambench.optics.jit import cache_folder, kernel

@kernel
def total(n):
    s = 0.0
    for i in range(n):
        s += i
    return s

if __name__ == "__main__":
    import beambench, probe
    try:
        Path(__file__).with_name("written").touch()
        writable = True
    except OSError:
        writable = False
    value = probe.total(5)
    print(json.dumps({"uid": os.getuid(), "package": beambench.__file__, "value": value, "writable": writable,
                      "cache": str(cache_folder()), "kernels": len(list(cache_folder().rglob("*.nbi")))}))
'''

# root may write anywhere: either another user runs the probe, or root without the right to override permissions.
AS = {
    "another user": ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"],
    "without privilege": ["setpriv", "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-all"],
}


@pytest.fixture
def tree(project: Path) -> Iterator[Path]:
    """The package laid out as installed, with no right to write in it, and open to all users to read."""
    # Not pytest's own folder: that one is closed to other users.
    with tempfile.TemporaryDirectory(prefix="beambench-readonly-") as name:
        top = Path(name)
        top.chmod(0o755)
        site = top / "site"
        shutil.copytree(project / "api", site / "beambench", ignore=shutil.ignore_patterns("__pycache__"))
        for floor in FLOORS:
            shutil.copytree(project / floor, site / "beambench" / floor, ignore=shutil.ignore_patterns("__pycache__"))
        (site / "probe.py").write_text(PROBE)
        (top / "scratch").mkdir()
        (top / "scratch").chmod(0o1777)
        for path in [site, *site.rglob("*")]:
            path.chmod(0o555 if path.is_dir() else 0o444)
        yield top
        for path in [site, *site.rglob("*")]:
            path.chmod(0o755 if path.is_dir() else 0o644)


@pytest.mark.parametrize(
    ("user", "home"),
    [("another user", "unset"), ("another user", "unwritable"), ("without privilege", "unwritable")],
)
def test_read_only_tree_without_a_home(tree: Path, user: str, home: str) -> None:
    prefix: list[str] = []
    if os.getuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root may write anywhere, and `setpriv` (util-linux) is not here to give that up")
        prefix = AS[user]
    elif user == "another user":
        pytest.skip("only root may become another user; to this one the tree is read-only as it is")
    environment = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(tree / "site"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "TMPDIR": str(tree / "scratch"),
    }
    if home == "unwritable":
        environment["HOME"] = str(tree / "site")
    command = [*prefix, sys.executable]
    can_start = subprocess.run(
        [*command, "-c", "import numba"], env=environment, capture_output=True, check=False, cwd=tree
    )
    if can_start.returncode != 0:
        pytest.skip(f"{user}: this Python may not be read by that user")
    run = subprocess.run(
        [*command, str(tree / "site" / "probe.py")],
        env=environment,
        cwd=tree,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    assert not told["writable"], "the tree was not read-only: the test would prove nothing"
    assert Path(told["package"]).is_relative_to(tree / "site")
    assert told["value"] == 10.0
    cache = Path(told["cache"])
    assert cache.is_relative_to(tree / "scratch"), f"the cache went to {cache}"
    assert told["kernels"] >= 1, "nothing was cached"
