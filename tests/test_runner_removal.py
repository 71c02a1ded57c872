"""What a plug-in leaves in its folder is removed: of any depth, without rights, links, and nothing behind a link."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from beambench.benchmarks.runner.removal import remove

#: As another user, whom the rights of a folder bind (root is bound by none).
_AS_NOBODY = """
import os, sys
from pathlib import Path
from beambench.benchmarks.runner.removal import remove
os.setgid(65534); os.setuid(65534)
place = Path(sys.argv[1]) / "x"
(place / "a" / "b" / "c").mkdir(parents=True)
(place / "a" / "b" / "file").write_text("")
for name in ("a/b/c", "a/b", "a"):
    (place / name).chmod(0)
place.chmod(0)
remove(place)
sys.exit(os.path.lexists(place))
"""


def test_folders_of_any_depth_are_removed(tmp_path: Path) -> None:
    top, here = tmp_path / "x", os.getcwd()
    top.mkdir()
    os.chdir(top)
    try:
        for _ in range(3000):  # 6,000 characters of path, beyond what a system call takes
            os.mkdir("d")
            os.chdir("d")
        Path("file").write_text("")
    finally:
        os.chdir(here)
    remove(top)
    assert not list(tmp_path.iterdir())


def test_nothing_behind_a_link_is_touched(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "mine").write_text("mine")
    top = tmp_path / "x"
    (top / "a").mkdir(parents=True)
    (top / "a" / "link").symlink_to(outside)
    (top / "link").symlink_to(outside)
    (tmp_path / "whole").symlink_to(outside)
    for path in (top, tmp_path / "whole", tmp_path / "none"):
        remove(path)
    assert [path.name for path in tmp_path.iterdir()] == ["outside"] and (outside / "mine").read_text() == "mine"


def test_a_file_in_place_of_a_folder_is_removed(tmp_path: Path) -> None:
    (tmp_path / "x").write_text("")
    remove(tmp_path / "x")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_folders_without_rights_are_removed(tmp_path: Path) -> None:
    place = tmp_path / "place"
    place.mkdir()
    os.chmod(place, 0o777)
    for path in (tmp_path, *tmp_path.parents):
        if path.stat().st_uid == os.geteuid() and path != Path("/"):
            os.chmod(path, path.stat().st_mode | 0o011)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    done = subprocess.run([sys.executable, "-c", _AS_NOBODY, str(place)], env=environment, check=False, cwd="/")
    assert done.returncode == 0
