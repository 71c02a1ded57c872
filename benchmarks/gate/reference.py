"""The version that the present one is timed against: a git revision or a wheel, installed into a folder of its own.

The folder stands before everything else on the import path of the reference's processes, whose interpreter and libraries are
those of this process: only the code differs. A revision that needs other libraries than these is not built with them.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from ...scenes.errors import InputError
from .build_errors import build_error, unmet_requirements

__all__ = ["CannotBuild", "build_reference", "commit_of"]

_LIMIT_S = 600.0


class CannotBuild(Exception):
    """The reference exists and cannot be installed: the reason."""


def _git(project: Path, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(
            ["git", "-C", str(project), *arguments], capture_output=True, check=False, timeout=_LIMIT_S,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except FileNotFoundError as error:
        raise InputError(
            "The program git is not installed.", where="--against", next_step="give a wheel instead"
        ) from error


def commit_of(project: Path) -> str:
    """The revision that is checked out, "" outside of a repository or without git."""
    try:
        found = _git(project, "rev-parse", "HEAD")
    except InputError:
        return ""
    return found.stdout.decode().strip() if found.returncode == 0 else ""


def build_reference(against: str, project: Path, scratch: Path) -> Path:
    """Install the reference and return its folder.

    Main arguments:
        against: a wheel file, or a git revision of `project`. scratch: a private folder.

    Raises:
        InputError: neither a wheel nor a revision.
        CannotBuild: it could not be installed.
    """
    target = scratch / "reference"
    source = Path(against)
    if source.suffix == ".whl":
        if not source.is_file():
            raise InputError("There is no such wheel.", where="--against", value=against)
        _install(str(source.resolve()), target, ())
        return target
    tree = scratch / "tree"
    tree.mkdir()
    if _git(project, "rev-parse", "--verify", "--quiet", f"{against}^{{commit}}").returncode:
        raise InputError(
            "The reference is neither a wheel nor a revision of the project's repository.", where="--against", value=against,
            allowed="FILE.whl, or a branch, tag or commit", next_step=f"git -C {project} log --oneline",
        )  # fmt: skip
    top = Path(_git(project, "rev-parse", "--show-toplevel").stdout.decode().strip())
    inside = project.resolve().relative_to(top.resolve())
    packed = _git(top, "archive", "--format=tar", f"{against}^{{commit}}")
    if packed.returncode:
        raise CannotBuild(f"git archive: {packed.stderr.decode(errors='replace').strip()}")
    unpacked = subprocess.run(["tar", "-x", "-C", str(tree)], input=packed.stdout, capture_output=True, check=False)
    if unpacked.returncode:
        raise CannotBuild(f"tar: {unpacked.stderr.decode(errors='replace').strip()}")
    # The build tools of this environment are used where it has them: nothing is downloaded then.
    alone = find_spec("setuptools") is None
    try:
        _install(str(tree / inside), target, () if alone else ("--no-build-isolation",))
    except CannotBuild as error:
        if not alone and (unmet := unmet_requirements(tree / inside)):
            raise CannotBuild(f"{unmet} ({error})") from error
        raise
    return target


def _install(what: str, target: Path, options: tuple[str, ...]) -> None:
    command = [
        sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps", *options,
        "--target", str(target), what,
    ]  # fmt: skip
    try:
        done = subprocess.run(
            command, capture_output=True, check=False, timeout=_LIMIT_S, stdin=subprocess.DEVNULL, text=True
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CannotBuild(str(error)) from error
    if done.returncode:
        raise CannotBuild(f"pip install: {build_error(done.stderr or done.stdout)}")
