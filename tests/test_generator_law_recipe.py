"""The recipe of CONTRIBUTING.md for a reflection law, followed word for word: every rung generates with the new law."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

#: Finds the files that the recipe adds or changes before those of the project.
OVERLAY = """
import importlib.abc, importlib.util, pathlib, sys

class Overlay(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        file = pathlib.Path(sys.argv[1], *name.split(".")[1:]).with_suffix(".py")
        return importlib.util.spec_from_file_location(name, file) if file.is_file() else None

sys.meta_path.insert(0, Overlay())
"""

#: What must hold of a law that was added.
CHECK = """
import numpy as np
from beambench.generator.bsdf.plugin import mitsuba_bsdf
from beambench.generator.generate import generate
from beambench.generator.rays.backend import mitsuba
from beambench.optics.reflection.albedo import conserves_energy, hemispherical_albedo
from beambench.optics.reflection.angles import angles
from beambench.scenes.load import load_scene

data = {"kind": "minnaert", "albedo": 0.6, "k": 1.5}
small = {"rig.camera.rows": 8, "rig.camera.cols": 8, "rig.delays.count": 6, "rig.delays.repeats": 1, "rig.delays.laser_off": 0}
wall = load_scene("flat-wall", {**small, "target.0.material": data})
material = wall.target[0].material
theta = np.array([0.0, 0.7, 1.2])
np.testing.assert_allclose(hemispherical_albedo(material.response, theta), 0.6 * np.cos(theta) ** 0.5, rtol=1e-4)
assert conserves_energy(material.response) and abs(material.albedo_at_normal() - 0.6) < 1e-6
assert material.largest_albedo()[0] <= 0.6 + 1e-6 and material.with_lobe(0.3) is None
assert (material.without_diffuse().response(angles([0, 0, 1], [0, 0, 1], [0, 0, 1])) == 0).all()

# Both forms are one law, and Mitsuba's samples return the albedo.
mi = mitsuba()
import drjit as dr

rng = np.random.default_rng(1)
def directions(count):
    z, phi = rng.uniform(0.05, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z])
wi, wo = directions(4096), directions(4096)
bsdf, si = mitsuba_bsdf(material), dr.zeros(mi.SurfaceInteraction3f, 4096)
si.wi = mi.Vector3f(wi.astype(np.float32))
value = np.asarray(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.astype(np.float32))).numpy()).ravel()
np.testing.assert_allclose(value, material.response(angles([0.0, 0.0, 1.0], wo.T, wi.T)), rtol=1e-5)
si.wi = mi.Vector3f(float(np.sin(0.7)), 0.0, float(np.cos(0.7)))
point = mi.Point2f(*rng.uniform(size=(2, 4096)).astype(np.float32))
weight = np.asarray(bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), point)[1].numpy()).ravel()
expected = 0.6 * np.cos(0.7) ** 0.5
assert abs(weight.mean() - expected) < 4 * weight.std() / 64, (weight.mean(), expected)

# One wall has no second bounce: both rungs agree, and the brightest light is that of the response.
def electrons(scene, **arguments):
    return generate(scene, seed=1, rtol=1e-2, truth_electrons=True, **arguments)
direct, full = (electrons(wall, fidelity=rung)["truth_electrons"].values for rung in ("direct", "full"))
np.testing.assert_allclose(full, direct, rtol=1e-5)
matt = electrons(load_scene(wall, {"target.0.material": {"kind": "lambert", "albedo": 0.6}}), fidelity="direct")
ratio = float(electrons(wall, fidelity="direct")["truth_amplitude"][4, 4] / matt["truth_amplitude"][4, 4])
assert abs(ratio - 1.25) < 1e-3, ratio  # (k + 1)/2 at normal incidence

# Two walls that face each other: the light between them is less than a geometric series of the albedo.
side = {"name": "side", "material": data, "shape": {
    "kind": "rectangle", "center_m": [0.3, 0.0, 4.6], "width_m": 1.0, "height_m": 2.0, "tilt_x_deg": 0.0, "tilt_y_deg": 80.0}}
corner = load_scene(wall, {"target": [wall.target[0].model_dump(mode="json"), side]})
made = electrons(corner, fidelity="full", truth_components=True)
between, once = (float(made[f"truth_{name}"].sum()) for name in ("interreflection", "direct"))
assert 0.0 < between < 0.6 / (1.0 - 0.6) * once, (between, once)
print("followed", round(between / once, 4))
"""


def steps(guide: str) -> str:
    """The part of the guide that is about a reflection law."""
    return guide[guide.index("**a reflection law**") : guide.index("**a formula of one")]


def follow(project: Path, folder: Path, plant: tuple[str, str] = ("", "")) -> subprocess.CompletedProcess[str]:
    """Follow the recipe in `folder`, with `plant` = (what, by what) replaced in its blocks, and run the check."""
    recipe = steps((project / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    assert plant[0] in recipe
    blocks = dict(re.findall(r"```python\n# (\S+)\n(.*?)```", recipe.replace(*plant), re.DOTALL))
    assert set(blocks) == {"optics/reflection/minnaert.py", "scenes/materials.py", "generator/bsdf/minnaert.py"}
    for name in ("optics/reflection/minnaert.py", "generator/bsdf/minnaert.py"):
        assert not (project / name).exists(), "the example is not a law of the project"
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text(blocks[name], encoding="utf-8")

    materials = (project / "scenes" / "materials.py").read_text(encoding="utf-8")
    top, record = blocks["scenes/materials.py"].split("\n\n\n", 1)
    table = "#: The table of reflection laws.\n"
    assert materials.count("from .base import") == materials.count(table) == materials.count("| Chua,") == 1
    materials = materials.replace("from .base import", f"{top}\nfrom .base import")
    materials = materials.replace(table, f"{record}\n\n{table}").replace("| Chua,", "| Chua | Minnaert,")
    (folder / "scenes").mkdir()
    (folder / "scenes" / "materials.py").write_text(materials, encoding="utf-8")

    (line,) = re.findall(r"`(\"minnaert\": [^`]*,)`", recipe)
    laws = (project / "generator" / "bsdf" / "laws.py").read_text(encoding="utf-8")
    opening = "LAWS: dict[str, str] = {\n"
    assert laws.count(opening) == 1
    laws = laws.replace(opening, f"{opening}    {line}\n")
    (folder / "generator" / "bsdf" / "laws.py").write_text(laws, encoding="utf-8")
    command = [sys.executable, "-c", OVERLAY + CHECK, str(folder)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)


def test_the_recipe_of_a_reflection_law(project: Path, tmp_path: Path) -> None:
    run = follow(project, tmp_path)
    assert run.returncode == 0, run.stderr
    assert "followed" in run.stdout


@pytest.mark.parametrize(
    "plant",
    [
        ("(self.k + 1.0) * (0.5 / dr.pi)", "(self.k + 1.1) * (0.5 / dr.pi)"),  # Mitsuba's form is another law
        ("return wo.z / dr.pi", "return wo.z / (2.0 * dr.pi)"),  # a density that its samples do not have
        ("(2.0 * np.pi) * (ci", "(1.0 * np.pi) * (ci"),  # more light than the docstring says
    ],
)
def test_the_check_refuses_a_wrong_law(plant: tuple[str, str], project: Path, tmp_path: Path) -> None:
    run = follow(project, tmp_path, plant)
    assert run.returncode == 1 and "AssertionError" in run.stderr, run.stderr
