"""Suite files: load, override and hash them, and list their captures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ...scenes.datasets.spec import list_datasets
from ...scenes.errors import InputError
from ...scenes.load import anchored_overrides, list_scenes, load_scene
from ...scenes.nearest import did_you_mean
from ...scenes.overrides import apply_overrides
from ...scenes.scene import Scene
from ...scenes.spec_files import find_spec_file, read_spec_file
from ...scenes.validate import validate_spec
from .mismatch import check_mismatch, mismatched
from .parts import without_parts
from .sealed import Key
from .spec import Calibration, Condition, Draw, Limits, Rung, SceneEntry, Seeds, Split, Stress, Suite
from .stress import stressed
from .variants import without_variants

__all__ = [
    "CELL_NONE", "SUITES", "Calibration", "Cell", "Condition", "Draw", "Limits", "Loaded", "SceneEntry", "Seeds", "Split",
    "Stress", "Suite", "capture_key", "cell_name", "cells_of", "check_rungs", "drawn_scene", "list_suites", "load_suite",
    "suite_hash",
]  # fmt: skip

#: Folder of the built-in suites.
SUITES = Path(__file__).parent / "library"

#: `stress` of a cell with the unchanged scene.
CELL_NONE = "none"


@dataclass(frozen=True)
class Cell:
    """One generated capture of a suite: the scene with its stress applied, its key in the table, and the rung that renders it
    (None: the cheapest of the scene's modality). `secret`: the seed of a sealed capture, of which `seed` is only the number."""

    scene_name: str
    scene: Scene
    stress: str
    level: float
    stress2: str
    level2: float
    seed: int
    key: int
    fidelity: Rung | None = None
    secret: int | None = None

    @property
    def random_seed(self) -> int:
        """The seed of everything random in the capture and its calibration."""
        return self.seed if self.secret is None else self.secret


@dataclass(frozen=True)
class Loaded:
    """A validated suite and its loaded scenes."""

    suite: Suite
    scenes: tuple[tuple[str, Scene], ...]
    hash: str

    def fidelity(self, name: str) -> Rung:
        """The rung of a scene, by its name in the suite: its entry's, or the suite's."""
        return self._entry(name).fidelity or self.suite.fidelity

    def own_rungs(self) -> dict[str, int]:
        """The place of every entry of `scenes` that has a rung of its own, by the scene's name in the suite."""
        entries = zip(self.scenes, self.suite.scenes, strict=True)
        return {name: place for place, ((name, _), entry) in enumerate(entries) if entry.fidelity is not None}

    def _entry(self, name: str) -> SceneEntry:
        """The entry of a scene, by its name in the suite."""
        entries = zip(self.scenes, self.suite.scenes, strict=True)
        return next(entry for (held, _), entry in entries if held == name)

    def draws(self, name: str) -> tuple[Draw, ...]:
        """What is drawn anew for every seed of a scene, by its name in the suite."""
        return tuple(draw for draw in self.suite.draws if not draw.scenes or name in draw.scenes)

    def stresses(self, name: str) -> tuple[Stress, ...]:
        """The stresses of a scene, by its name in the suite."""
        return tuple(stress for stress in self.suite.stresses if not stress.scenes or name in stress.scenes)

    def under(self, stress: Stress) -> tuple[tuple[str, Scene], ...]:
        """The scenes under a stress of the suite, by their names."""
        return tuple((name, scene) for name, scene in self.scenes if not stress.scenes or name in stress.scenes)

    def conditions(self, name: str) -> tuple[Condition, ...]:
        """The conditions under which a scene is run, by its name in the suite."""
        own = self._entry(name).conditions
        return tuple(one for one in self.suite.conditions if not own or one in own)

    def reads(self, label: str, name: str) -> bool:
        """Whether an estimator of the suite, by the label that the suite writes, reads a scene, by its name in the suite."""
        own = self._entry(name).estimators
        return not own or label in own or all(label not in entry.estimators for entry in self.suite.scenes)


def list_suites() -> list[str]:
    """Names of the built-in suites, sorted."""
    return sorted(path.stem for path in SUITES.glob("*.toml"))


def _not_a_suite(source: str, kind: str) -> InputError:
    return InputError(
        f"This is a {kind}, not a suite.", where="suite", value=source,
        allowed="the name of a suite (beambench suites list), or its .toml or .json file",
        next_step=f"beambench generate {source}",
    )  # fmt: skip


def _check_is_suite(source: str) -> None:
    """Refuse the name of a scene or a data set. Raises InputError."""
    if source not in list_suites():
        for kind, names in (("scene", list_scenes()), ("data set", list_datasets())):
            if source in names and not Path(source).is_file():
                raise _not_a_suite(source, kind)


def load_suite(source: str | Path | Mapping[str, Any], overrides: Mapping[str, Any] | None = None) -> Loaded:
    """Load and validate a suite and all its scenes.

    Main arguments:
        source: the name of a built-in suite, a path to a .toml or .json file, or plain data.
        overrides: {path: value}. A path whose first part is a key of the suite changes the suite; one whose first part
            is a key of scenes (`rig`, `target`, `medium`, `declared`) changes every scene.

    Files that the overrides of a suite *file* name lie in its folder or below; paths in `overrides` and in plain data are the
    user's own.

    Raises:
        InputError: a suite, scene or key is unknown, a value is missing or impossible, or two scenes have the same name.
    """
    if isinstance(source, Mapping):
        data, where, folder, own = dict(source), "suite data", Path.cwd(), True
    else:
        _check_is_suite(str(source))
        path = find_spec_file(str(source), SUITES, kind="suite", next_step="beambench run quickstart")
        data, where, folder, own = read_spec_file(path), str(source), path.parent, False
        if "rig" in data and not {"scenes", "parts"} & set(data):
            raise _not_a_suite(str(source), "scene")
        if "dataset" in data and "suite" not in data:
            raise _not_a_suite(str(source), "data set")
    of_suite, of_scenes = _split(overrides or {})
    of_variants = {path: value for path, value in of_suite.items() if path.split(".")[0] == "variants"}
    data = apply_overrides(data, of_variants) if of_variants else data
    data = without_parts(data, where, partial(_part, folder=folder))
    variants = data.get("variants", {})
    data = without_variants(data, where)
    if len(of_suite) > len(of_variants):  # these apply to scenes without variants; new scenes may name variants too
        data = apply_overrides(data, {path: value for path, value in of_suite.items() if path not in of_variants})
        data = without_variants({**data, "variants": variants}, where)
    suite = validate_spec(Suite, data, where)
    loaded: list[tuple[str, Scene]] = []
    for entry in suite.scenes:
        changes = entry.overrides if own else anchored_overrides(entry.overrides, folder)
        scene = load_scene(_anchor(entry.scene, folder), {**changes, **of_scenes})
        loaded.append((entry.name or scene.name, scene))
    names = [name for name, _ in loaded]
    if len(set(names)) != len(names):
        raise InputError(
            "Two scenes of the suite have the same name.",
            where=f"{where}: scenes",
            value=names,
            next_step='give one of them its own name: { scene = "...", name = "..." }',
        )
    result = Loaded(suite, tuple(loaded), suite_hash(suite, loaded))
    _check_scenes(result, where)
    return result


def _check_scenes(loaded: Loaded, where: str) -> None:
    """Refuse, before anything runs, draws and stresses of unknown scenes or paths, and estimators that are not the suite's."""
    names = [name for name, _ in loaded.scenes]
    for key, items in (("draws", loaded.suite.draws), ("stresses", loaded.suite.stresses)):
        for item in items:
            if unknown := set(item.scenes) - set(names):
                raise InputError(
                    f"One of the {key} names a scene that the suite does not have.",
                    where=f"{where}: {key}", value=sorted(unknown), allowed=", ".join(names),
                )  # fmt: skip
    check_mismatch(loaded.suite.mismatch, where)
    for name, scene in loaded.scenes:
        if "mismatched" in loaded.conditions(name):
            mismatched(scene, loaded.suite.mismatch)
        for draw in loaded.draws(name):
            stressed(scene, [(draw.axis, draw.high)])
        for stress in loaded.stresses(name):
            _stressed(scene, stress, stress.values[0], stress.values2[0] if stress.values2 else None)


def _part(name: str, folder: Path) -> dict[str, Any]:
    """The data of a part of a suite, by its name or its file, with variants written out and the paths in it resolved."""
    path = find_spec_file(_anchor(name, folder), SUITES, kind="suite", next_step="beambench run quickstart")
    data = without_variants(read_spec_file(path), name)
    scenes = data.get("scenes")
    if not isinstance(scenes, list | tuple):
        return data  # validation refuses it, and entries of another form
    entries = [{"scene": item} if isinstance(item, str) else item for item in scenes]
    return data | {"scenes": [_anchored(one, path.parent) if isinstance(one, dict) else one for one in entries]}


def _anchored(entry: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    changes, scene = entry.get("overrides"), entry.get("scene")
    held = {"overrides": anchored_overrides(changes, folder)} if isinstance(changes, dict) else {}
    return {**entry, **held, **({"scene": _anchor(scene, folder)} if isinstance(scene, str) else {})}


def _anchor(name: str, folder: Path) -> str:
    """Resolve relative paths of scene files from the folder of the suite file."""
    path = Path(name).expanduser()
    if path.suffix in {".toml", ".json"} and not path.is_absolute() and (folder / path).is_file():
        return str(folder / path)
    return name


def _split(overrides: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    suite_keys = {*Suite.model_fields, "variants"}
    scene_keys = set(Scene.model_fields) - {"name", "title", "schema_version"}
    of_suite: dict[str, Any] = {}
    of_scenes: dict[str, Any] = {}
    for path, value in overrides.items():
        first = path.split(".")[0]
        if first in suite_keys:
            of_suite[path] = value
        elif first in scene_keys:
            of_scenes[path] = value
        else:
            raise InputError(
                "An override's path leads nowhere.",
                where=path,
                value=first,
                allowed="a key of the suite ("
                + ", ".join(sorted(suite_keys))
                + ") or of every scene ("
                + ", ".join(sorted(scene_keys))
                + ")",
                next_step=did_you_mean(first, sorted(suite_keys | scene_keys)),
            )
    return of_suite, of_scenes


def suite_hash(suite: Suite, scenes: Iterable[tuple[str, Scene]]) -> str:
    """SHA-256 (16 hex digits) of the validated suite and scenes, independent of their notation."""
    data = {
        "suite": suite.model_dump(mode="json", exclude={"title"}),
        "scenes": {name: scene.model_dump(mode="json", exclude={"title"}) for name, scene in scenes},
    }
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def capture_key(scene: str, stress: str, level: float, stress2: str = CELL_NONE, level2: float = float("nan")) -> int:
    """The capture's key in `SeedSequence(seed, spawn_key=(key, stage, block))`: 48 bits of SHA-256 of its axes."""
    text = json.dumps([scene, stress, repr(float(level)), stress2, repr(float(level2))])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")


def _stressed(scene: Scene, stress: Stress, level: float, level2: float | None) -> Scene:
    levels = [(stress.axis, level)]
    if stress.axis2 is not None and level2 is not None:
        levels.append((stress.axis2, level2))
    return stressed(scene, levels)[0]


def cells_of(loaded: Loaded, split: Split = "test", key: Key | None = None) -> list[Cell]:
    """All captures of a suite, in a fixed order: every scene unchanged, then at each stress level, for each seed. With a `key`
    there are as many sealed ones, numbered from 1."""
    seeds = getattr(loaded.suite.seeds, split)
    if not seeds:
        raise InputError(f"The suite has no {split} seeds.", where="seeds", next_step="add them to the suite file")
    nan = float("nan")
    cells: list[Cell] = []
    secrets = {number: key.seed(loaded.suite.suite, number) for number in range(1, len(seeds) + 1)} if key else {}
    seeds = list(secrets) or seeds
    for name, scene in loaded.scenes:
        rung = loaded.fidelity(name)
        of_seed = {seed: drawn_scene(name, scene, loaded.draws(name), secrets.get(seed, seed)) for seed in seeds}
        grid: list[tuple[str, float, str, float, dict[int, Scene]]] = [(CELL_NONE, nan, CELL_NONE, nan, of_seed)]
        for stress in loaded.stresses(name):
            for level in stress.values:
                for level2 in stress.values2 or (None,):
                    changed = _each(of_seed, partial(_stressed, stress=stress, level=level, level2=level2))
                    second = (stress.axis2 or CELL_NONE, nan if level2 is None else level2)
                    grid.append((stress.axis, level, *second, changed))
        for axis, level, axis2, second_level, changed in grid:
            number = capture_key(name, axis, level, axis2, second_level)
            cells += [
                Cell(name, changed[seed], axis, level, axis2, second_level, seed, number, rung, secrets.get(seed))
                for seed in seeds
            ]
    return cells


def check_rungs(cells: Iterable[Cell], rtol: float) -> None:
    """Raise InputError for a cell whose rung is not built for its scene, or cannot model it, before anything is generated."""
    from ...generator.checked import checked

    for cell in cells:
        if cell.fidelity is not None:
            checked(cell.scene, seed=cell.random_seed, capture_key=cell.key, fidelity=cell.fidelity, rtol=rtol)


def _each(scenes: Mapping[int, Scene], change: Callable[[Scene], Scene]) -> dict[int, Scene]:
    """Every scene changed; scenes that are one object are changed once."""
    made = {id(scene): change(scene) for scene in {id(one): one for one in scenes.values()}.values()}
    return {seed: made[id(scene)] for seed, scene in scenes.items()}


def drawn_scene(name: str, scene: Scene, draws: Sequence[Draw], seed: int) -> Scene:
    """The scene of one seed: every draw at its level, low + u (high − low), u from the hash of scene, axis and seed."""
    for draw in draws:
        digest = hashlib.sha256(json.dumps(["draw", name, draw.axis, seed]).encode()).digest()
        level = draw.low + int.from_bytes(digest[:6], "big") / 2**48 * (draw.high - draw.low)
        scene = stressed(scene, [(draw.axis, level)])[0]
    return scene


def cell_name(scene: str, levels: Iterable[tuple[str, float]], seed: int) -> str:
    """A folder name for a cell: readable, and valid for any names of axes; `levels` are its axes and levels, NaN for none."""
    parts = [scene, *(f"{axis}={level!r}" for axis, level in levels if level == level), f"seed={seed}"]
    return "".join(c if c.isalnum() or c in "._=-+" else "-" for c in "__".join(parts))
