"""The package that `estimators new` writes: one for every stage, which keeps the laws, states its error and is found by pip."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import beambench
from beambench.benchmarks.judges.bound import truths_of
from beambench.benchmarks.laws.check import fed, laws_of, maker_of
from beambench.benchmarks.runner.job import Job
from beambench.benchmarks.runner.protocol import write_capture, write_meta
from beambench.benchmarks.runner.session import Outcome, Session, run_sessions
from beambench.benchmarks.scores.truth import aligned, errors_of
from beambench.benchmarks.suites.spec import Limits
from beambench.captures.hide import hide_truth
from beambench.captures.layouts import stages
from beambench.captures.quantities import Stage
from beambench.captures.sizes import sizes_of
from beambench.estimators import get_estimator
from beambench.estimators.labels import links_of
from beambench.estimators.package import templates
from beambench.scenes.errors import InputError

STAGES = list(stages())
#: Surveys and gates are one element each: an rms of n errors is known to 1/√(2n).
CAPTURES = {"spectrum": 8, "turbulence": 8}


def _named(stage: str) -> str:
    return f"my-{stage.replace('_', '-')}"


def _laid(site: Path, name: str, module: str, text: str) -> None:
    """A package as pip leaves it: a module and a .dist-info with its entry point."""
    info = site / f"{module}-1.0.dist-info"
    info.mkdir(parents=True)
    (site / f"{module}.py").write_text(text)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    entry = f"{name} = {module}:{name.replace('-', '_')}"
    (info / "entry_points.txt").write_text(f"[beambench.estimators]\n{entry}\n")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages of all stages, as they are written."""
    folder = tmp_path_factory.mktemp("written")
    for stage in STAGES:
        beambench.estimators_new(_named(stage), stage=stage, out=folder / stage)
    return folder


@pytest.fixture
def site(written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the search path with all of them."""
    for stage in STAGES:
        name = _named(stage)
        module = f"beambench_{name.replace('-', '_')}"
        _laid(tmp_path, name, module, (written / stage / f"{module}.py").read_text())
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    return tmp_path


def missing(known: dict[str, Stage]) -> set[str]:
    """Stages without a template."""
    return set(known) - set(templates())


def test_every_stage_has_a_template_and_every_template_a_stage() -> None:
    assert missing(stages()) == set() and set(templates()) == set(stages()) and len(STAGES) >= 13


def test_a_new_stage_without_a_template_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    more = {**stages(), "echo": Stage("echo", "echo", "none", ("capture",), ())}
    assert missing(more) == {"echo"}
    for home in ("beambench.estimators.package.stage_of", "beambench.captures.layouts.stage_of"):
        monkeypatch.setattr(home, more.__getitem__)
    with pytest.raises(InputError, match="no template") as caught:
        beambench.estimators_new("my-echo", stage="echo", out=tmp_path / "echo")
    assert set(caught.value.allowed.split(", ")) == set(STAGES) and not (tmp_path / "echo").exists()


def test_an_unknown_stage_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such stage"):
        beambench.estimators_new("my-echo", stage="sound", out=tmp_path / "echo")


@pytest.mark.parametrize("stage", STAGES)
def test_a_template_keeps_the_laws(stage: str, site: Path) -> None:
    assert (site / f"beambench_my_{stage}.py").is_file()
    names, judge = laws_of(_named(stage))
    results = judge(None)
    assert [result for result in results if not result.holds] == []
    assert len(names) == len(results) >= 20


@pytest.mark.parametrize("stage", STAGES)
def test_a_template_states_its_error(stage: str, site: Path) -> None:
    """The root mean square of error over sigma, against the truth of the clean captures of the laws.

    A bias that all elements share, as that of a reference, is a tenth or two; Wiener's variance takes the image as if it were
    even over all frequencies, which overstates it by two at most.
    """
    found = get_estimator(fed(_named(stage)))
    assert (site / f"beambench_my_{stage}.py").is_file()
    parts = []
    for seed in range(1, 1 + CAPTURES.get(stage, 1)):
        capture = maker_of(stage).stressed(seed)
        truths = truths_of(capture)
        quantity = found.stage.gives[0]
        truth = truths[quantity.name]
        result = found(hide_truth(capture))
        arrays = {str(name): variable.values for name, variable in result.variables.items()}
        value, sigma, valid = aligned(arrays, found.stage, quantity, truth.value.shape)
        good = valid & np.isfinite(truth.value)
        assert good.sum() >= 0.5 * np.isfinite(truth.value).sum()
        parts.append((errors_of(value, truth) / sigma)[good])
    z = np.concatenate(parts)
    assert z.size >= 8
    chance = 4 / np.sqrt(2 * z.size)
    assert 0.45 - chance < np.sqrt((z**2).mean()) < 1.25 + chance


_HOSTILE = """
import os
from beambench.estimators import estimator

@estimator("{stage}", cites="planted")
def my_hostile(*inputs):
    open({marker!r}, "w").write("was here")
    os._exit(7)
"""


@pytest.mark.parametrize("stage", STAGES)
def test_a_hostile_plug_in_is_contained_at_every_stage(
    stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may neither write outside of its folder nor end more than its own process."""
    site, marker = tmp_path / "site", tmp_path / "marker"
    _laid(site, "my-hostile", f"hostile_{stage}", _HOSTILE.format(stage=stage, marker=str(marker)))
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]))
    importlib.invalidate_caches()
    capture = hide_truth(maker_of(stage).stressed(1))
    folder = tmp_path / "capture"
    write_capture(folder, capture)
    write_meta(folder, capture, "matched")
    job = Job(0, folder, "matched", str(capture.attrs["modality"]), sizes_of(capture), timed=False)
    limits = Limits(time_s=60.0, memory_bytes=2**31, warmup_s=240.0)
    label = fed("my-hostile")
    assert links_of(label)[-1] == "my-hostile"
    outcomes: list[Outcome] = []
    run_sessions([Session(label, [job], limits, tmp_path / "scratch")], lambda _, one: outcomes.append(one))
    (outcome,) = outcomes
    assert not marker.exists() and not outcome.arrays
    assert outcome.status.startswith(("crash:", "error: ")), outcome.status


def test_editable_packages_are_found_by_their_entry_points(written: Path, tmp_path: Path) -> None:
    """As an author types it: pip install -e, here into a folder of its own, for all stages at once."""
    if importlib.util.find_spec("pip") is None or importlib.util.find_spec("setuptools") is None:
        pytest.skip("pip or setuptools is not installed")
    flags = ["--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--quiet"]
    packages = [item for stage in STAGES for item in ("-e", str(written / stage))]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *flags, "--prefix", str(tmp_path), *packages],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    (packed,) = tmp_path.glob("lib*/python*/site-packages")
    code = (
        f"import site, json; site.addsitedir({str(packed)!r}); from beambench.estimators import get_estimator as g; "
        f"print(json.dumps({{n: g(n).stage.word for n in {[_named(stage) for stage in STAGES]!r}}}))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout) == {_named(stage): stage for stage in STAGES}
    for stage in STAGES:
        readme = (written / stage / "README.md").read_text()
        assert _named(stage) in readme and "pip install -e" in readme and "{" not in readme


def test_a_stage_that_is_none_is_answered_by_the_nearest() -> None:
    for word, near in (("gate", "did you mean gated"), ("centroids", "did you mean centroid")):
        with pytest.raises(InputError, match=near):
            beambench.estimators_new("my-own", stage=word)
