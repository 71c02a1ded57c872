"""The version that is timed against: what the gate says where it cannot be built."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from pathlib import Path

import pytest

from beambench.benchmarks.gate.build_errors import build_error, unmet_requirements
from beambench.benchmarks.gate.reference import CannotBuild, build_reference

#: pip 23 with setuptools 65.5 and without wheel.
OLD_TOOLS = """\
  error: subprocess-exited-with-error

  × Preparing metadata (pyproject.toml) did not run successfully.
  │ exit code: 1
  ╰─> [14 lines of output]
      running dist_info
      creating '/tmp/pip-modern-metadata-9igj3fxc/half_sum-0.1.0.dist-info'
      error: invalid command 'bdist_wheel'
      [end of output]

  note: This error originates from a subprocess, and is likely not a problem with pip.
error: metadata-generation-failed

× Encountered error while generating package metadata.
╰─> See above for output.

note: This is an issue with the package mentioned above, not pip.
hint: See above for details.
"""


def test_the_error_is_that_of_the_build_and_not_pips_hints() -> None:
    assert build_error(OLD_TOOLS) == "error: invalid command 'bdist_wheel'"
    compiler = (
        "  × x\n  ╰─> [3 lines of output]\n a.c:1:10: fatal error: b.h: none\n error: command 'gcc' failed\n note: x\n"
    )
    assert build_error(compiler) == "a.c:1:10: fatal error: b.h: none; error: command 'gcc' failed"
    assert build_error("/usr/bin/python: No module named pip\n") == "/usr/bin/python: No module named pip"
    assert build_error(OLD_TOOLS.replace("error: invalid", "the")).endswith("the command 'bdist_wheel'")
    assert build_error("") == "it failed without a message"


def _project(folder: Path, requires: str) -> Path:
    folder.mkdir()
    (folder / "pyproject.toml").write_text(
        f'[build-system]\nrequires = ["{requires}"]\nbuild-backend = "setuptools.build_meta"\n'
        '[project]\nname = "broken"\nversion = "1"\n'
    )
    return folder


def test_what_a_build_requires_and_is_not_installed_is_told_with_the_command(tmp_path: Path) -> None:
    told = unmet_requirements(_project(tmp_path / "a", "numpy>=9999"))
    assert told.startswith("its build requires numpy>=9999 (") and told.endswith(": pip install -U 'numpy>=9999'")
    assert "(none is installed)" in unmet_requirements(_project(tmp_path / "b", "no-such-build-tool"))
    assert unmet_requirements(_project(tmp_path / "c", "numpy>=1")) == ""
    assert unmet_requirements(_project(tmp_path / "d", "numpy>=9999; python_version < '3'")) == ""
    assert unmet_requirements(tmp_path) == "", "no pyproject.toml"


def test_the_examples_workflow_installs_what_its_build_requires(project: Path) -> None:
    workflow = (project / "docs" / "gate-project" / ".github" / "workflows" / "gate.yml").read_text(encoding="utf-8")
    assert "pip install -U setuptools .\n" in workflow


def test_a_revision_that_cannot_be_built_says_why(tmp_path: Path) -> None:
    if shutil.which("git") is None or importlib.util.find_spec("setuptools") is None:
        pytest.skip("git and setuptools build the reference")
    home, scratch = _project(tmp_path / "project", "setuptools>=9999"), tmp_path / "scratch"
    (home / "setup.py").write_text("raise RuntimeError('the glue is missing')\n")
    for command in (
        ("init", "-q"), ("add", "-A"), ("-c", "user.name=t", "-c", "user.email=t@example.org", "commit", "-qm", "first"),
    ):  # fmt: skip
        subprocess.run(["git", "-C", str(home), *command], check=True, capture_output=True)
    scratch.mkdir()
    with pytest.raises(CannotBuild) as caught:
        build_reference("HEAD", home, scratch)
    told = str(caught.value)
    assert "RuntimeError: the glue is missing" in told and "pip install -U 'setuptools>=9999'" in told
    assert "See above" not in told
