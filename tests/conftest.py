"""Fixtures of all tests: one thread per worker, the project folder, the folder of real captures."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    # Workers already fill the cores. Libraries read these as they load, so they are set before any is imported.
    for _name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(_name, "1")

ROOT = Path(__file__).resolve().parents[1]


def pytest_configure(config: pytest.Config) -> None:
    """Property tests draw the same examples on every run, and time no example: machines differ."""
    from hypothesis import settings

    settings.register_profile("beambench", derandomize=True, deadline=None, database=None)
    settings.load_profile("beambench")


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Name what fails, and what takes minutes, at once: a run that is stopped prints no summary."""
    if "PYTEST_XDIST_WORKER" in os.environ or not (report.failed or report.duration > 60.0):
        return
    last = report.longreprtext.strip().splitlines()[-1:] if report.failed else []
    print(f"\n{report.outcome} after {report.duration:.0f} s: {report.nodeid} ({report.when})", *last, flush=True)


@pytest.fixture
def long_run(request: pytest.FixtureRequest) -> None:
    """For tests marked slow that the default run leaves out; a shorter part of them is another test."""
    if "slow" not in str(request.config.getoption("-m")):
        pytest.skip("takes many minutes: pytest -m slow")


@pytest.fixture(scope="session")
def project() -> Path:
    """The project's own folder."""
    return ROOT


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real captures and meshes beside the checkout; skips where it is missing."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the folder of real captures is not beside the project (../shared/data)")
    return folder
