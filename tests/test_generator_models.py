"""The table of forward models, the one place of refusals, and lamps of any shape."""

from __future__ import annotations

import ast
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beambench.captures.compare import compare_captures
from beambench.captures.layouts import layout_of
from beambench.generator.checked import checked
from beambench.generator.gated.view import view_of
from beambench.generator.generate import generate
from beambench.generator.model import Model
from beambench.generator.models import MODELS, model_of
from beambench.generator.paths.world import PathWorld
from beambench.generator.rays.backend import mitsuba, opaque
from beambench.generator.rays.echo import echoes
from beambench.generator.rays.trace import Tracer, pixel_directions
from beambench.scenes.errors import InputError
from beambench.scenes.load import load_scene
from beambench.scenes.rigs import RIGS

Float = NDArray[np.float64]


def test_every_kind_of_rig_that_scenes_have_has_a_model() -> None:
    assert set(MODELS) <= set(RIGS) and MODELS
    for name in MODELS:
        model = model_of(name)
        assert isinstance(model, Model) and model.name == name and model.rungs[0] in ("direct", "geometric")
        assert set(model.apart) <= set(model.rungs)
        assert not model.clock or model.clock in layout_of(name).by_name
    with pytest.raises(InputError, match="no forward model"):
        model_of("sonar")


GOOD: dict[str, Any] = {"seed": 1, "capture_key": 1, "fidelity": "direct", "rtol": 1e-2}


@pytest.mark.parametrize(
    ("scene", "changes", "what", "where"),
    [
        ("flat-wall", {"fidelity": "best"}, "no such rung", "--fidelity"),
        ("flat-wall", {"rtol": "noise"}, "needs the fidelity", "--rtol"),
        ("flat-wall", {"rtol": True}, "fraction", "--rtol"),
        ("flat-wall", {"rtol": 0.6}, "fraction", "--rtol"),
        ("flat-wall", {"rtol": float("nan")}, "fraction", "--rtol"),
        ("flat-wall", {"seed": -1}, "not negative", "--seed"),
        ("counter", {"fidelity": "full"}, "not built for waveform scenes", "counter: --fidelity"),
        ("amcw", {"truth_components": True}, "no rung of this modality", "amcw: --truth-components"),
        (
            "flat-wall",
            {"truth_components": True, "fidelity": "auto"},
            "these rungs only: direct, scatter, full",
            "--truth-components",
        ),
    ],
)
def test_what_cannot_be_generated_is_refused_before_any_light(
    scene: str, changes: dict[str, Any], what: str, where: str
) -> None:
    loaded = load_scene(scene)
    with pytest.raises(InputError, match=what) as error:
        checked(loaded, **GOOD | changes, name=lambda n: "--" + n.replace("_", "-"))
    assert where in error.value.where
    with pytest.raises(InputError, match=what):
        generate(loaded, **GOOD | changes)


def test_a_request_is_checked_without_light_transport(project: Path) -> None:
    """The front door checks every request of a plan: that must not load what traces light."""
    import subprocess
    import sys

    code = (
        "import sys\nfrom beambench.generator.checked import checked\nfrom beambench.scenes.load import load_scene\n"
        "phase = {'medium.phase_function': {'kind': 'henyey-greenstein', 'g': 0.9}}\n"
        "for name, more in {'flat-wall': {}, 'counter': phase, 'amcw': phase}.items():\n"
        "    checked(load_scene(name, more), seed=1, capture_key=1, fidelity='auto', rtol='noise')\n"
        "print([m for m in ('mitsuba', 'drjit', 'numba') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["photodetector-5m", "amcw"])
def test_a_chosen_rung_repeats_from_the_record(name: str) -> None:
    """The record of a capture holds the requested fidelity, so that its repetition chooses again and is equal."""
    scene = load_scene(name, {"medium.scattering_per_m": 0.0})
    first = generate(scene, seed=3, fidelity="auto", rtol=0.1)
    kept = json.loads(first.attrs["provenance"])["arguments"]
    assert kept["fidelity"] == "auto" and kept["rtol"] == 0.1
    assert json.loads(first.attrs["fidelity"])["chosen"]["limit"] == 0.1
    again = generate(scene, **kept)
    assert compare_captures(first, again).equal


@dataclass(frozen=True)
class Sheet:
    """A laser sheet across x: even within ±`half_rad` in x, and within ±`thin_rad` in y."""

    half_rad: float
    thin_rad: float
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    source_radius_m: float = 0.0

    @property
    def _level(self) -> float:
        return 1.0 / (4.0 * self.half_rad * np.sin(self.thin_rad))

    def intensity(self, direction: Float) -> Float:
        """Even inside, 0 outside [1/sr]."""
        inside = np.abs(np.arctan2(direction[0], direction[2])) <= self.half_rad
        return np.where(inside & (np.abs(direction[1]) <= np.sin(self.thin_rad)), self._level, 0.0)

    def on_device(self) -> DeviceSheet:
        """The same in drjit."""
        return DeviceSheet(self)


@dataclass(frozen=True)
class DeviceSheet:
    """A `Sheet` in drjit arrays."""

    sheet: Sheet

    @property
    def position(self) -> Any:
        """Where it stands."""
        return mitsuba().Point3f(*(opaque(float(p)) for p in self.sheet.position_m))

    @property
    def axis(self) -> Any:
        """Along z."""
        return mitsuba().Vector3f(0.0, 0.0, 1.0)

    def intensity(self, direction: Any) -> Any:
        """As `Sheet.intensity`."""
        import drjit as dr

        inside = dr.abs(dr.atan2(direction.x, direction.z)) <= self.sheet.half_rad
        return dr.select(inside & (dr.abs(direction.y) <= float(np.sin(self.sheet.thin_rad))), self.sheet._level, 0.0)


def test_a_laser_sheet_is_a_lamp() -> None:
    """Light transport takes any lamp: echoes follow its intensity alone, and both of its forms agree."""
    scene = load_scene("flat-wall", {"rig.camera.rows": 41, "rig.camera.cols": 41})
    sheet = Sheet(half_rad=0.1, thin_rad=0.004)
    view = replace(view_of(scene), lamp=sheet)
    row, col = (a.ravel() for a in np.mgrid[:41, :41])
    direction, tracer = pixel_directions(view.camera, row, col), Tracer(scene)
    hits = tracer.trace((0.0, 0.0, 0.0), direction)
    by_sheet, by_beam = (echoes(scene, v, tracer, direction, hits) for v in (view, view_of(scene)))
    seen = sheet.intensity(direction) > 0
    assert seen.any() and not seen.all()
    np.testing.assert_array_equal(by_sheet.amplitude > 0, seen & (hits.target >= 0))
    ratio = sheet.intensity(direction) / view_of(scene).lamp.intensity(direction)
    np.testing.assert_allclose(by_sheet.amplitude, by_beam.amplitude * ratio, rtol=1e-12)
    np.testing.assert_array_equal(by_sheet.tau, by_beam.tau)
    mi, world = mitsuba(), PathWorld.of(scene, view)
    on_device = np.asarray(world.lamp.intensity(mi.Vector3f(direction.astype(np.float32))).numpy())
    # A direction on the very edge may fall to either side in float32.
    edge = np.abs(np.abs(direction[1]) - np.sin(sheet.thin_rad)) < 1e-6
    np.testing.assert_allclose(on_device[~edge], sheet.intensity(direction)[~edge], rtol=1e-6)


def rigs_named(source: str) -> list[str]:
    """Kinds of rig, and their classes' modules, that a source imports or names."""
    named = []
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.ImportFrom)
            and "rigs" in (node.module or "")
            and not (node.module or "").endswith("parts")
        ):
            named.append(f"{node.module}")
        if isinstance(node, ast.Attribute) and node.attr == "rig":
            named.append(".rig")
    return named


def test_light_transport_knows_no_rig(project: Path) -> None:
    files = [
        path for room in ("rays", "bsdf", "water", "paths") for path in (project / "generator" / room).glob("*.py")
    ]
    assert len(files) > 20
    assert {str(path): named for path in files if (named := rigs_named(path.read_text(encoding="utf-8")))} == {}


@pytest.mark.parametrize("breach", ["from ...scenes.rigs.gated import gated_rig", "laser = scene.rig.laser"])
def test_a_planted_rig_is_seen(breach: str) -> None:
    assert rigs_named(breach)
