"""The examples of docs/conventions.md are scenes that load."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beambench.scenes.load import load_scene

PAGE = Path(__file__).parents[1] / "docs" / "conventions.md"


def paths(data: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        path = before + name
        if path in ("target", "rig", "rig.camera", "rig.laser"):
            yield from paths(value, path + ".")
        else:
            yield path.replace("target.", "target.0."), value


def test_every_example_loads(tmp_path: Path) -> None:
    np.save(tmp_path / "chart.npy", np.full((4, 4), 0.5))
    blocks = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    examples = [dict(paths(tomllib.loads("\n".join(line.strip() for line in b.splitlines())))) for b in blocks]
    names = {name for example in examples for name in example}
    assert names == {
        "target.0.texture", "rig.screen", "rig.motion_m_per_s", "rig.ambient", "rig.camera.focus_distance_m",
        "rig.laser.source_radius_m", "rig.delays",
    }  # fmt: skip
    for example in examples:
        if "target.0.texture" in example:
            assert example["target.0.texture"]["file"].endswith(".png")
            example["target.0.texture"] = {"file": str(tmp_path / "chart.npy"), "encoding": "linear"}
        data = load_scene("flat-wall").model_dump(mode="json")
        if "rig.ambient" in example:
            del data["rig"]["ambient_e_per_s"]
        scene = load_scene(data, example).model_dump(mode="json")
        for path in example:
            found: Any = scene
            for part in path.split("."):
                found = found[int(part) if part.isdigit() else part]
            assert found, path
