"""Certificates of rangers, laser lines and lenslet cameras: right twins fail in nothing, wrong ones in the clause that names it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beambench
from beambench import InputError, cli
from beambench.benchmarks.twin.clause import Ask, Evidence
from beambench.benchmarks.twin.rendered import Cells, residuals
from beambench.benchmarks.twin.rig_file import TwinRig
from beambench.benchmarks.twin.run import certified, twin_kind_of
from beambench.benchmarks.twin.shared_clauses import RESIDUAL
from beambench.benchmarks.twin.verdict import judged
from beambench.captures.hide import hide_truth
from beambench.generator.generate import generate
from beambench.scenes.load import load_scene

#: Name of a scene -> (changes that make it small and telling, its rung).
SCENES: dict[str, tuple[dict[str, Any], Any]] = {
    "photodetector-5m": ({"rig.record.shots": 1600, "rig.record.samples": 400, "rig.laser.energy_fluctuation": 0.01}, None),
    "spotscan-wall": (
        {"rig.frames.lit": 12, "rig.frames.laser_off": 8, "rig.camera.rows": 64, "rig.camera.cols": 96}, None
    ),
    "gated-turbulence": (
        {"rig.frames.count": 8, "rig.turbulence.layers": [{"range_m": 3.0, "r0_m": 1.0}]}, "geometric"
    ),
}  # fmt: skip
FAULTS = [
    ("photodetector-5m", "pulse", {"rig.laser.pulse.fwhm_s": 5.25e-9}),
    ("photodetector-5m", "noise", {"rig.detector.readout.read_noise_e": 2.75e4}),
    ("photodetector-5m", "t0", {"rig.t0_s": 60e-12}),
    ("spotscan-wall", "width", {"rig.lens_sigma_px": 0.53}),
    ("spotscan-wall", "place", {"rig.laser.position_m": [0.1482, 0.0, 0.0260]}),
    ("spotscan-wall", "read-noise", {"rig.detector.read_noise_e": 66.0}),
    ("gated-turbulence", "width", {"rig.laser.wavelength_m": 585e-9}),
    ("gated-turbulence", "place-x", {"rig.lenslets.offset_m": [3e-6, 0.0]}),
    ("gated-turbulence", "read-noise", {"rig.detector.read_noise_e": 16.5}),
]


def _verdicts(name: str, hidden: dict[str, Any], draws: int = 10) -> dict[str, str]:
    base, fidelity = SCENES[name]
    real = hide_truth(generate(load_scene(name, {**base, **hidden}), seed=5, fidelity=fidelity))
    found = certified(real, Ask(None, load_scene(name, base), fidelity, draws, 1, ()))  # type: ignore[arg-type]
    return {one.clause.name: str(one.verdict) for one in found.clauses}


@pytest.mark.parametrize("name", SCENES)
def test_a_right_twin_fails_in_nothing_and_shows_what_its_clauses_are_about(name: str) -> None:
    verdicts = _verdicts(name, {})
    assert "fail" not in verdicts.values()
    assert {"offset", "pulse" if "pulse" in verdicts else "width"} <= {k for k, v in verdicts.items() if v == "pass"}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "clause", "hidden"), FAULTS)
def test_a_wrong_twin_fails_the_clause_that_names_it(name: str, clause: str, hidden: dict[str, Any]) -> None:
    """The rig differs from its scene by 5 % of the pulse, 10 % of the noise or of the lens, 60 ps, .5 mm of the laser, 3 µm of the
    array or 10 % of the wavelength."""
    assert _verdicts(name, hidden)[clause] == "fail"


def test_a_recording_without_its_scene_or_with_another_is_refused(tmp_path: Path) -> None:
    base, _ = SCENES["spotscan-wall"]
    real = hide_truth(generate(load_scene("spotscan-wall", base), seed=5))
    with pytest.raises(InputError, match="rendered from a scene"):
        certified(real, Ask(None, None, None, 10, 1, ()))
    with pytest.raises(InputError, match="another kind"):
        certified(real, Ask(None, "photodetector-5m", None, 10, 1, ()))
    with pytest.raises(InputError, match="frames of the recording"):
        certified(real, Ask(None, "spotscan-wall", None, 10, 1, ()))
    scene: Any = load_scene("spotscan-wall", base)
    with pytest.raises(InputError, match="no number of the rig"):
        certified(real, Ask(TwinRig({}, {"rig.lens_sigma": 0.1}, "a file"), scene, None, 10, 1, ()))


def test_residuals_of_the_twins_own_draws_are_those_of_noise() -> None:
    """Draws that are left out of the mean in turn are as far from it as a recording: χ² of both has the same mean."""
    rng = np.random.default_rng(1)
    model = 100.0 + 50.0 * rng.random((20, 30))
    draws = model + 3.0 * rng.standard_normal((40, 20, 30))
    own = [residuals(Cells(draws[k], 1), np.delete(draws, k, axis=0))["residual"] for k in range(40)]
    real = [
        residuals(Cells(1.1 * (model + 3.0 * rng.standard_normal(model.shape)), 1), draws[1:])["residual"]
        for _ in range(40)
    ]
    # The factor 1.1 scales noise too.
    assert np.mean(real) / 1.1**2 == pytest.approx(np.mean(own), rel=0.02)


def test_equal_values_without_any_scatter_pass() -> None:
    """Nothing differs, nothing is tolerated: it was a division by zero."""
    one = judged([RESIDUAL], Evidence({"residual": 0.0}, [{"residual": 0.0}] * 9, {}, {}, {}, ()))[0]
    assert one.verdict == "pass"
    tight = judged(
        [type(RESIDUAL)(**{**vars(RESIDUAL), "absolute": 0.0})],
        Evidence({"residual": 0.0}, [{"residual": 0.0}] * 9, {}, {}, {}, ()),
    )[0]
    assert tight.verdict == "pass"


@pytest.mark.slow
def test_the_command_writes_the_page(tmp_path: Path) -> None:
    base, _ = SCENES["photodetector-5m"]
    scene = load_scene("photodetector-5m", {**base, "rig.record.shots": 60}).model_dump(mode="json")
    (tmp_path / "mine.json").write_text(json.dumps(scene))
    beambench.generate(tmp_path / "mine.json", seeds=[3], out=tmp_path / "real.zarr")
    typed = ["twin", str(tmp_path / "real.zarr"), "--scene", str(tmp_path / "mine.json"), "--draws", "9"]
    assert cli.main([*typed, "-o", str(tmp_path / "page")]) in (0, 3)
    page = (tmp_path / "page" / "certificate.html").read_text(encoding="utf-8")
    assert "waveform-ml" in page and "nan" not in page.lower().replace("nano", "")


def test_kinds_with_clauses() -> None:
    for name in SCENES:
        assert twin_kind_of(load_scene(name).modality).clauses
