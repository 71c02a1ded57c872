"""Random valid scenes give valid light: no NaN, no infinity, no negative value; equal bits for equal seeds."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from beambench.captures.validate import validate
from beambench.generator.generate import GenerationWarning, generate

from ._random_scenes import draw_scene

#: All of them, and how many the default run takes: every twelfth and a bit.
ALL, STEP = 500, 12


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A mesh that hides parts of itself, and a texture with black in it."""
    import trimesh

    folder = tmp_path_factory.mktemp("files")
    trimesh.creation.torus(0.3, 0.1, major_sections=24, minor_sections=12).export(folder / "ring.ply")
    np.save(folder / "map.npy", np.random.default_rng(1).choice([0.0, 0.3, 1.0], size=(9, 7)))
    return folder / "ring.ply", folder / "map.npy"


def check(number: int, files: tuple[Path, Path], *, twice: bool = True) -> str:
    scene, rung, _ = draw_scene(number, *files)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a warning of NumPy is a fault of ours
        warnings.simplefilter("ignore", GenerationWarning)
        one = generate(scene, seed=number, fidelity=rung, rtol=0.02, truth_electrons=True)  # type: ignore[arg-type]
        if twice:
            two = generate(scene, seed=number, fidelity=rung, rtol=0.02, truth_electrons=True)  # type: ignore[arg-type]
            xr.testing.assert_identical(one.drop_attrs(), two.drop_attrs())
    validate(one)
    data = {"gated": "counts", "waveform": "signal", "amcw": "samples"}[scene.modality]
    for name in (data, "truth_electrons", "truth_amplitude", "truth_background"):
        if name in one:
            value = one[name].values.astype(np.float64)
            assert np.isfinite(value).all(), f"{number}: {name}"
            assert (value >= 0).all(), f"{number}: {name} down to {value.min()}"
    reach = one["truth_range"].values
    assert not np.isinf(reach).any() and (reach[np.isfinite(reach)] > 0).all()
    if scene.modality == "gated":
        seen = np.isfinite(reach)
        assert (np.isfinite(one["truth_depth"].values) == seen).all()
        albedo = one["truth_albedo"].values[seen]
        assert ((albedo >= 0) & (albedo < 50)).all(), "Chua's law is not bounded by 1"
        normal = np.linalg.norm(one["truth_normal"].values[seen], axis=-1)
        assert np.abs(normal - 1).max(initial=0.0) < 1e-5
    lit = float(one["truth_amplitude"].max()) > 0
    return f"{scene.modality} {rung} {'lit' if lit else 'dark'}"


@pytest.mark.parametrize("part", range(3))
def test_random_scenes_give_sound_light(part: int, files: tuple[Path, Path]) -> None:
    kinds = [check(n, files, twice=n % 5 == 0) for n in range(part * STEP, ALL, 3 * STEP)]
    print(sorted(kinds))


@pytest.mark.slow
def test_all_random_scenes_give_sound_light(files: tuple[Path, Path], long_run: None) -> None:
    kinds = [check(number, files) for number in range(ALL)]
    count = {kind: kinds.count(kind) for kind in sorted(set(kinds))}
    print(count)
    # Every modality at both rungs, and most of them with light.
    assert len({kind.rsplit(" ", 1)[0] for kind in kinds}) == 6
    assert sum(n for kind, n in count.items() if kind.endswith(" lit")) > 0.6 * ALL
