"""`beambench generate`: captures of a scene or of a suite's cells, or the repetition of a store."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .output import default_out

if TYPE_CHECKING:
    import xarray as xr

    from .benchmarks.progress import Progress
    from .captures.compare import Comparison
    from .scenes.scene import Scene

__all__ = ["Generated", "generate"]


@dataclass(frozen=True)
class Generated:
    """What `generate` made, or with `plan` would make.

    `plan`: one entry per capture (scene, seed, sizes, bytes of the counts). `paths`: stores written. `comparison`: with
    `like`, one per capture; `differing` counts the values whose bits differ.
    """

    plan: list[dict[str, Any]]
    paths: list[Path] = field(default_factory=list)
    comparison: list[Comparison] = field(default_factory=list)

    @property
    def differing(self) -> int:
        """Number of values that differ from the store given as `like`."""
        return sum(item.differing for item in self.comparison)

    @property
    def equal(self) -> bool:
        """Equal bits and attributes in all captures compared."""
        return all(item.equal for item in self.comparison)


@dataclass(frozen=True)
class _Item:
    """One capture to make."""

    scene: Scene
    seed: int
    key: int | None
    fidelity: Literal["direct", "scatter", "full", "auto"]
    rtol: float | Literal["noise"]
    truth_electrons: bool
    truth_components: bool = False


def generate(
    source: str | Path | Mapping[str, Any] | Scene | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    seeds: Sequence[int] = (0,),
    fidelity: Literal["direct", "scatter", "full", "auto"] | None = None,
    rtol: float | Literal["noise"] | None = None,
    truth_electrons: bool = False,
    truth_components: bool = False,
    like: str | Path | None = None,
    plan: bool = False,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Generated:
    """Generate captures with their truth and store them.

    Main arguments:
        source: a scene (name, file, data); one capture per seed goes into one store. Or a suite (name, file): its test
            captures as written, one store per scene inside the folder `out`.
        overrides: {path: value}, applied before validation.
    Other arguments:
        seeds: for a scene.
        fidelity, rtol: rung of the forward model, and the relative error aimed at; by default the suite's, or "direct"
            and 1e-3. rtol "noise", for fidelity "auto": below one standard deviation of the detector's noise.
        truth_electrons: keep the noise-free expectation of each sample as well.
        truth_components: keep the stacks that the lamp's light is the sum of as well: `truth_direct`,
            `truth_interreflection`, `truth_single` and `truth_multiple`; with fidelity "full" of gated scenes only.
        like: a store to repeat from its own records; the new captures are compared with it value by value, and written
            only if `out` is given.
        plan: tell what would be made, and make nothing.
        out, resume, overwrite: where to write, and what to do where that exists.

    Raises:
        InputError: bad input, or an output that exists.
    """
    from .benchmarks.progress import silent
    from .scenes.errors import InputError

    if (source is None) == (like is None):
        raise InputError("Give either a scene or suite, or --like STORE.", where="generate", allowed="one of the two")
    if like is not None:
        return _repeat(Path(like), plan, out, overwrite, progress or silent)
    groups = _items(source, dict(overrides or {}), seeds, fidelity, rtol, truth_electrons, truth_components)
    planned = [_planned(item) for items in groups.values() for item in items]
    if plan:
        return Generated(planned)
    single = len(groups) == 1 and "" in groups
    base = (
        Path(out).expanduser()
        if out is not None
        else default_out(next(iter(groups.values()))[0].scene.name if single else str(source))
    )
    paths = []
    done = 0
    for name, items in groups.items():
        path = base if single else base / f"{name}.zarr"
        paths.append(_write(path, items, resume, overwrite, progress or silent, done, len(planned)))
        done += len(items)
    return Generated(planned, paths)


def _items(
    source: Any,
    overrides: dict[str, Any],
    seeds: Sequence[int],
    fidelity: Literal["direct", "scatter", "full", "auto"] | None,
    rtol: float | Literal["noise"] | None,
    electrons: bool,
    components: bool,
) -> dict[str, list[_Item]]:
    """Captures to make by store; the one store of a scene has the name ""."""
    from .benchmarks.suite import CELL_NONE, cells_of, load_suite
    from .scenes.load import load_scene

    if _is_suite(source):
        loaded = load_suite(source, overrides)
        rung: Any = fidelity or loaded.suite.fidelity
        aimed: Any = loaded.suite.rtol if rtol is None else rtol
        groups: dict[str, list[_Item]] = {}
        for cell in cells_of(loaded):
            if cell.stress == CELL_NONE:
                item = _Item(cell.scene, cell.seed, cell.key, rung, aimed, electrons, components)
                groups.setdefault(cell.scene_name, []).append(item)
        return groups
    scene = load_scene(source, overrides)
    aimed = 1e-3 if rtol is None else rtol
    rung = fidelity or "direct"
    return {"": [_Item(scene, seed, None, rung, aimed, electrons, components) for seed in seeds]}


def _is_suite(source: Any) -> bool:
    from .benchmarks.suite import list_suites
    from .scenes.load import list_scenes, read_spec_file

    if not isinstance(source, str | Path):
        return False
    path = Path(source).expanduser()
    if path.suffix in {".toml", ".json"} and path.is_file():
        return "scenes" in read_spec_file(path)
    return str(source) in list_suites() and str(source) not in list_scenes()


def _planned(item: _Item) -> dict[str, Any]:
    from .scenes.scene import sizes_of

    slices, rows, cols = sizes_of(item.scene)
    return {
        "scene": item.scene.name,
        "seed": item.seed,
        "slices": slices,
        "rows": rows,
        "cols": cols,
        "bytes": 2 * slices * rows * cols,
        "fidelity": item.fidelity,
        "rtol": item.rtol,
    }


def _write(
    path: Path, items: list[_Item], resume: bool, overwrite: bool, tell: Progress, done: int, total: int
) -> Path:
    from .captures.store import CaptureWriter

    with CaptureWriter(path, overwrite=overwrite, resume=resume) as writer:
        for position, item in enumerate(items):
            tell("generate", done + position, total, item.scene.name)
            if position >= writer.count:
                writer.append(_make(item))
        tell("generate", done + len(items), total, str(path))
    return path


def _make(item: _Item) -> xr.Dataset:
    from .generator.generate import generate as make

    return make(
        item.scene,
        seed=item.seed,
        capture_key=item.key,
        fidelity=item.fidelity,
        rtol=item.rtol,
        truth_electrons=item.truth_electrons,
        truth_components=item.truth_components,
    )


def _repeat(like: Path, plan: bool, out: str | Path | None, overwrite: bool, tell: Progress) -> Generated:
    """Make a store again from the scene and the arguments that each capture records, and compare."""
    from .captures.compare import compare_captures
    from .captures.store import open_captures, write

    captures = open_captures(like)
    items = [_recorded(captures.attributes(index), f"{like}, capture {index}") for index in range(len(captures))]
    planned = [_planned(item) for item in items]
    if plan:
        return Generated(planned)
    comparison = []

    def remade() -> Iterator[xr.Dataset]:
        for index, item in enumerate(items):
            tell("generate", index, len(items), item.scene.name)
            capture = _make(item)
            comparison.append(compare_captures(captures[index], capture))
            yield capture
        tell("generate", len(items), len(items), "")

    if out is None:
        for _ in remade():
            pass
        return Generated(planned, [], comparison)
    path = write(Path(out).expanduser(), remade(), overwrite=overwrite)
    return Generated(planned, [path], comparison)


def _recorded(attrs: Mapping[str, Any], where: str) -> _Item:
    from .scenes.errors import InputError
    from .scenes.load import load_scene

    try:
        arguments = json.loads(attrs["provenance"])["arguments"]
        scene = load_scene(json.loads(attrs["truth_scene"]))
        return _Item(
            scene,
            int(arguments["seed"]),
            int(arguments["capture_key"]),
            arguments["fidelity"],
            "noise" if arguments["rtol"] == "noise" else float(arguments["rtol"]),
            bool(arguments["truth_electrons"]),
            bool(arguments.get("truth_components", False)),
        )
    except (KeyError, TypeError, json.JSONDecodeError) as error:
        raise InputError(
            "The capture does not record how it was generated.",
            where=where,
            value=str(error),
            allowed="a capture that `beambench generate` made",
        ) from error
