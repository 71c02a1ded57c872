"""A plug-in that ends the process, hangs or dies breaks the law under test: the check neither dies nor passes it."""

from __future__ import annotations

import time
from pathlib import Path

import psutil
import pytest

import beambench
from beambench.benchmarks.laws import trial as law_trial
from beambench.benchmarks.laws.check import check_laws, maker_of
from beambench.benchmarks.laws.suite import laws_for
from beambench.benchmarks.runner.jail import abi
from beambench.benchmarks.runner.namespaces import works
from beambench.scenes.errors import InputError

_MODULE = """
import json, os, sys, time
import numpy as np, xarray as xr
from beambench.estimators import estimator
{at_import}

@estimator("gated", cites="none")
def bad(capture, *, threshold: float = 1.0):
    print("printed by the plug-in")
    counts = capture["counts"].values
    if counts.max() == 0:
        {all_zero}
    elif counts.min() == counts.max() == 100:
        {constant}
    shape = counts.shape[1:]
    nothing = np.full(shape, np.nan)
    dims = ("row", "col")
    return xr.Dataset(
        {{"range": (dims, nothing), "sigma": (dims, nothing), "valid": (dims, np.zeros(shape, dtype=bool))}}
    )
"""


def _install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, at_import: str = "", all_zero: str = "pass",
             constant: str = "pass") -> None:  # fmt: skip
    info = tmp_path / "trial_plugin-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: trial-plugin\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[beambench.estimators]\nbad = trial_plugin:bad\n")
    text = _MODULE.format(at_import=at_import, all_zero=all_zero, constant=constant)
    (tmp_path / "trial_plugin.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))


def test_a_plugin_that_leaves_breaks_that_law_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    _install(tmp_path, monkeypatch, all_zero="os._exit(0)", constant="sys.exit(0)")
    found = {result.law: result for result in beambench.estimators_check("bad", compare=False).laws}
    assert list(found) == list(laws_for(maker_of("gated")))
    assert found["finite or invalid: all zero"].seen == "It ended the process (exit code 0)."
    assert found["finite or invalid: constant"].seen == "SystemExit: 0"
    assert found["same answer twice"].holds and found["finite or invalid: saturated"].holds
    printed = capfd.readouterr()
    assert printed.out == "" and "printed by the plug-in" in printed.err


def test_a_law_that_does_not_end_is_broken_and_the_rest_not_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _install(tmp_path, monkeypatch, all_zero="time.sleep(60)")
    found = {result.law: result for result in law_trial.try_laws("bad", limit_s=8.0)}
    assert list(found) == list(laws_for(maker_of("gated")))
    assert found["finite or invalid: all zero"].seen == "It did not end within 8 s."
    assert found["finite or invalid: constant"].seen.startswith("Not tried")
    assert found["same answer twice"].holds


def test_an_import_that_ends_the_process_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _install(tmp_path, monkeypatch, at_import="sys.exit(0)")
    with pytest.raises(InputError, match="Estimator bad cannot be imported: SystemExit: 0"):
        beambench.estimators_check("bad")


@pytest.mark.skipif(not (abi() and works()), reason="no Landlock or no namespaces")
def test_a_plugin_is_checked_and_listed_in_the_jail(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It reads no file of the user and writes none, neither as it is imported nor in a law, and leaves no process behind."""
    secret = tmp_path / "secret" / "truth.npz"
    secret.parent.mkdir()
    secret.write_text("truth")
    site = tmp_path / "site"
    site.mkdir()
    sleeps = f"import time; time.sleep(600) # {tmp_path}"
    leave = f"import subprocess; subprocess.Popen([sys.executable, '-c', {sleeps!r}], start_new_session=True)"
    _install(
        site, monkeypatch, at_import=leave, all_zero=f"open({str(secret)!r})", constant=f"open({str(secret)!r}, 'a')"
    )
    found = {result.law: result for result in beambench.estimators_check("bad", compare=False).laws}
    assert "Permission denied" in found["finite or invalid: all zero"].seen
    assert "Permission denied" in found["finite or invalid: constant"].seen
    assert found["same answer twice"].holds
    (site / "trial_plugin.py").write_text(f"open({str(secret)!r})\n")
    (row,) = [row for row in beambench.estimators_list() if row["name"] == "bad"]
    assert "Permission denied" in row["error"]
    time.sleep(0.2)
    left = [
        process.pid for process in psutil.process_iter(["cmdline"]) if f"# {tmp_path}" in str(process.info["cmdline"])
    ]
    assert not left


def test_bad_names_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _install(tmp_path, monkeypatch)
    with pytest.raises(InputError, match="no such estimator") as raised:
        beambench.estimators_check("bat")
    assert "bad" in str(raised.value)
    with pytest.raises(InputError, match="unknown parameter"):
        beambench.estimators_check("bad[limit=3]")


@pytest.mark.parametrize("stage", ["gated", "amcw"])
def test_in_this_process_an_exit_is_a_broken_law_and_an_interrupt_is_the_users(stage: str) -> None:
    def leaves(capture: object) -> object:
        raise SystemExit(0)

    def interrupted(capture: object) -> object:
        raise KeyboardInterrupt

    assert not any(result.holds for result in check_laws(leaves, stage))
    with pytest.raises(KeyboardInterrupt):
        check_laws(interrupted, stage)
