"""The example of a project that is gated from outside, docs/gate-project: its parts fit, and it works as docs/gate.md says."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from beambench.captures.hide import hide_truth
from beambench.captures.layouts import stage_of
from beambench.cli import app
from beambench.estimators.result import check_result
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

from ._cli_options import options_of


@pytest.fixture
def example(project: Path) -> Path:
    return project / "docs" / "gate-project"


def test_its_estimator_reads_the_scenes_of_its_suite(example: Path) -> None:
    made = tomllib.loads((example / "pyproject.toml").read_text())
    target = made["project"]["entry-points"]["beambench.estimators"]["half-sum"]
    module, _, name = target.partition(":")
    spec = importlib.util.spec_from_file_location("example_half_sum", example / f"{module}.py")
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    suite = tomllib.loads((example / "suite.toml").read_text())
    assert suite["estimators"] == ["half-sum"] and len(suite["seeds"]["test"]) * len(suite["scenes"]) >= 6
    entry = suite["scenes"][1]
    capture = generate(load_scene(entry["scene"], entry["overrides"]), seed=1)
    answer = getattr(loaded, name)(hide_truth(capture))
    check_result(answer, capture, "half-sum", stage_of("gated"))
    found = answer["range"].values - capture["truth_range"].values
    assert answer["valid"].values.mean() > 0.9 and abs(found[answer["valid"].values]).mean() < 0.1


def test_every_option_that_guide_and_workflow_name_exists(project: Path, example: Path) -> None:
    known = {line.split(":", 1)[0] + " " + name for line in options_of(app) for name in re.findall(r"--[a-z-]+", line)}
    text = (project / "docs" / "gate.md").read_text() + (example / ".github/workflows/gate.yml").read_text()
    typed = re.findall(r"beambench gate [^\n`]*(?:\n +--[^\n]*)*", text)
    options = {option for command in typed for option in re.findall(r"--[a-z-]+", command)}
    assert {"--baseline", "--against", "--junit", "--update"} <= options
    assert {f"gate {option}" for option in options} <= known


def test_the_baseline_of_this_projects_own_gate_is_that_of_its_suite(project: Path) -> None:
    from beambench.benchmarks.suites.suite import cells_of, load_suite

    loaded = load_suite(project / ".ci" / "gate" / "suite.toml")
    baseline = json.loads((project / ".ci" / "gate" / "baseline.json").read_text(encoding="utf-8"))
    assert (baseline["suite"], baseline["suite_version"]) == (loaded.suite.suite, loaded.suite.version)
    assert len(baseline["cells"]) == len(cells_of(loaded)) and len({scene.modality for _, scene in loaded.scenes}) == 5
    script = (project / ".ci" / "run").read_text(encoding="utf-8")
    assert ".ci/gate/suite.toml" in script and ".ci/gate/baseline.json" in script


def _run(folder: Path, *command: str, path: str = "") -> subprocess.CompletedProcess[str]:
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [path, environment.get("PYTHONPATH", "")]))
    return subprocess.run(
        list(command), cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=900
    )


@pytest.mark.slow
def test_it_works_as_the_guide_says(example: Path, tmp_path: Path, long_run: None) -> None:
    """First baseline; no change passes, also in speed; twice the work and a worse estimator are red."""
    if shutil.which("git") is None or importlib.util.find_spec("setuptools") is None:
        pytest.skip("git and setuptools build the reference")
    home, site = tmp_path / "project", tmp_path / "site"
    shutil.copytree(example, home)
    for command in (
        ("init", "-q"), ("config", "user.name", "tester"), ("config", "user.email", "t@example.org"), ("add", "-A"),
        ("commit", "-qm", "first"),
    ):  # fmt: skip
        assert _run(home, "git", *command).returncode == 0
    pip = (sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--upgrade")
    beambench = (sys.executable, "-m", "beambench")

    def install() -> None:
        shutil.rmtree(home / "build", ignore_errors=True)
        done = _run(home, *pip, "--target", str(site), ".")
        assert done.returncode == 0, done.stderr

    def gate(*more: str) -> subprocess.CompletedProcess[str]:
        return _run(home, *beambench, "gate", "run", "--baseline", "baseline.json", *more, path=str(site))

    def suite() -> None:
        done = _run(home, *beambench, "run", "suite.toml", "-o", "run", "--overwrite", "--no-report", path=str(site))
        assert done.returncode == 0, done.stderr

    install()
    suite()
    done = gate("--update", "--why", "first baseline")
    assert done.returncode == 0, done.stderr
    suite()
    done = gate("--figures", "accuracy", "--figures", "sigma")
    assert done.returncode == 0, done.stdout + done.stderr
    done = gate("--figures", "speed", "--against", "HEAD", "--effects", "speed=0.5", "--starts", "4")
    assert done.returncode in (0, 3) and "A/A" in done.stdout, done.stdout + done.stderr
    assert "regression" not in done.stdout

    source = home / "half_sum.py"
    text = source.read_text()
    line = "    below = np.cumsum(light - np.median(light, axis=0), axis=0)\n"
    assert line in text
    source.write_text(text.replace(line, line * 4))  # more of the same work
    install()
    done = gate(
        "--figures", "speed", "--against", "HEAD", "--effects", "speed=0.2", "--starts", "5", "--junit", "gate.xml"
    )
    assert done.returncode in (1, 3), done.stdout + done.stderr
    assert "A/A" in done.stdout and ("failure" in (home / "gate.xml").read_text()) == (done.returncode == 1)
    source.write_text(text.replace("np.median(light, axis=0)", "np.median(light[::3], axis=0)"))
    install()
    suite()
    done = gate("--figures", "accuracy")
    assert done.returncode in (0, 1, 3) and "equal numbers" not in done.stdout
