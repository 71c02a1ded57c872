"""Recorded spot fields of a telescope, where the folder beside the project holds them: slopes and coefficients of their authors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beambench.benchmarks.checks import sh_mmtwfs
from beambench.scenes.errors import InputError

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "sh_mmtwfs"


@pytest.fixture
def recorded() -> Path:
    pytest.importorskip("astropy", reason="astropy is not installed (extra `peers`)")
    if not FOLDER.is_dir():
        pytest.skip(f"no folder {FOLDER.name} beside the project")
    return FOLDER


def test_slopes_and_coefficients_are_those_of_the_authors(recorded: Path) -> None:
    """Hexagonal lenslets, spots up to 16 px of 31 px from their places. The authors fit sums of columns and rows, we the image."""
    one = sh_mmtwfs.compared(recorded, "f9", "spot-gaussian")
    assert one.both >= 130 and one.slopes_px > 8.0
    assert one.slope_rms_px < 0.08
    assert one.zernike_rms_nm < 80.0


def test_the_frame_that_the_authors_refuse_is_refused(recorded: Path) -> None:
    with pytest.raises(InputError, match="too few spots"):
        sh_mmtwfs.compared(recorded, "mmirs", "spot-gaussian", image=sh_mmtwfs.BOGUS)


def test_coefficients_of_a_known_wavefront() -> None:
    """100 nm of Z04, 2ρ² − 1: a slope of 4ρ·100 nm per radius, in pixels of 1e-6 rad on a mirror of 3.251 m, falling outward."""
    at = np.random.default_rng(1).uniform(-0.7, 0.7, (60, 2))
    sensor = sh_mmtwfs.Sensor(6e-4, 0.04, 2e-5, 1e-6, 400.0, 40.0, (0.0, 0.0), 6e-7)
    moved = -4.0 * at * 100e-9 / 3.251 / 1e-6
    nm = sh_mmtwfs.zernikes_nm(at, moved, sensor)
    assert nm[2] == pytest.approx(100.0, rel=1e-9) and np.abs(np.delete(nm, 2)).max() < 1e-6
