"""The captures of a data set, one by one: of a scene and its seeds, or of a suite; all are checked before any is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ...scenes.errors import InputError
from ...scenes.nearest import did_you_mean

if TYPE_CHECKING:
    from ...scenes.scene import Scene
    from ..suites.sealed import Key
    from .sealed import Seal

__all__ = ["Fidelity", "Item", "Rtol", "check_items", "is_suite", "items_of", "planned"]

Fidelity = Literal["direct", "scatter", "full", "geometric", "isolated", "coherent", "auto"]
Rtol = float | Literal["noise"]

#: Bytes that generation needs per sample (electrons in float32, counts in uint16) and per slice (its coordinates).
_BYTES_PER_SAMPLE, _BYTES_PER_SLICE = 6, 40


@dataclass(frozen=True)
class Item:
    """One capture to make; with a `seal` it is stored without truth."""

    scene: Scene
    seed: int
    key: int | None
    fidelity: Fidelity
    rtol: Rtol
    truth_electrons: bool
    truth_components: bool = False
    truth_instances: bool = False
    seal: Seal | None = None


def is_suite(source: Any) -> bool:
    """Whether `source` is the name or the file of a suite."""
    from ...scenes.load import list_scenes
    from ...scenes.spec_files import read_spec_file
    from ..suites.suite import list_suites

    if not isinstance(source, str | Path):
        return False
    path = Path(source).expanduser()
    if path.suffix in {".toml", ".json"} and path.is_file():
        return bool({"scenes", "parts"} & set(read_spec_file(path)))
    return str(source) in list_suites() and str(source) not in list_scenes()


def _check_name(source: Any) -> None:
    """Refuse a name that is no scene's, and say what else it may be. Raises InputError."""
    from ...scenes.datasets.spec import list_datasets
    from ...scenes.load import list_scenes
    from ...scenes.spec_files import LIBRARY, find_spec_file
    from ..suites.suite import list_suites

    known = {"scenes": list_scenes(), "suites": list_suites(), "data sets": list_datasets()}
    names = [name for some in known.values() for name in some]
    if not isinstance(source, str | Path) or Path(source).expanduser().is_file() or str(source) in names:
        return
    if Path(source).suffix or "/" in str(source):  # a path, which nobody takes for a name
        find_spec_file(str(source), LIBRARY, kind="scene", next_step="beambench scenes list")
    raise InputError(
        "There is no such scene, suite or data set.", where="source", value=str(source),
        allowed="; ".join(["a path to a .toml or .json file", *(f"{kind}: {', '.join(some)}" for kind, some in known.items())]),
        next_step=did_you_mean(str(source), names, "beambench scenes list", cutoff=0.4),
    )  # fmt: skip


def items_of(
    source: Any,
    overrides: dict[str, Any],
    seeds: Sequence[int] | None,
    fidelity: Fidelity | None,
    rtol: Rtol | None,
    electrons: bool,
    components: bool,
    instances: bool = False,
    key: Key | None = None,
) -> dict[str, list[Item]]:
    """Captures to make, by the name of their store; the one store of a scene has the name "".

    With a `key` they are the sealed ones of a suite.

    Raises:
        InputError: No such scene or suite, seeds for a suite (it has its own), a key for a scene, or as `check_items`.
    """
    from ...generator.models import first_rung
    from ...scenes.load import load_scene
    from ..suites.suite import CELL_NONE, cells_of, load_suite
    from .sealed import Seal

    groups: dict[str, list[Item]] = {}
    if is_suite(source):
        if seeds is not None:
            raise InputError(
                "A suite has seeds of its own.",
                where="--seeds",
                value=list(seeds) if isinstance(seeds, Sequence) else seeds,
                next_step="change them with --set 'seeds.test=[1, 2]', or generate one of its scenes",
            )
        loaded = load_suite(source, overrides)
        aimed: Any = loaded.suite.rtol if rtol is None else rtol
        if key is not None and (fidelity or rtol or electrons or components or instances):
            raise InputError(
                "A sealed suite is made as its file says.", where="--sealed",
                allowed="no --fidelity, --rtol, --truth-electrons, --truth-components or --truth-instances",
            )  # fmt: skip
        for cell in cells_of(loaded, key=key):
            if cell.stress == CELL_NONE:
                rung: Any = fidelity or cell.fidelity
                seal = None if key is None else Seal(key.name, loaded.suite.suite, cell.scene_name, cell.seed)
                item = Item(cell.scene, cell.random_seed, cell.key, rung, aimed, electrons, components, instances, seal)
                groups.setdefault(cell.scene_name, []).append(item)
    elif key is not None:
        raise InputError("Only a suite can be sealed.", where="--sealed", value=str(source), next_step="name a suite")
    else:
        _check_name(source)
        numbers = _seeds(seeds)
        scene = load_scene(source, overrides)
        aimed = 1e-3 if rtol is None else rtol
        groups[""] = [
            Item(scene, n, None, fidelity or first_rung(scene), aimed, electrons, components, instances)
            for n in numbers
        ]
    check_items([item for items in groups.values() for item in items])
    return groups


def _seeds(seeds: Sequence[int] | None) -> list[int]:
    if seeds is None:
        return [0]
    numbers = list(seeds) if isinstance(seeds, Sequence) and not isinstance(seeds, str | bytes) else None
    if not numbers or any(isinstance(n, bool) or not hasattr(n, "__index__") or n < 0 for n in numbers):
        raise InputError("A seed is a whole number.", where="--seeds", value=seeds, allowed="0, 1, 2, …; at least one")
    twice = sorted({n for n in numbers if numbers.count(n) > 1})
    if twice:
        raise InputError(
            "A seed is given twice; the two captures would be equal.", where="--seeds", value=twice,
            allowed="different seeds",
        )  # fmt: skip
    return [int(n) for n in numbers]


def check_items(items: Sequence[Item]) -> None:
    """Refuse, before any work, captures that cannot be generated or do not fit into the memory of this machine.

    Raises:
        InputError: an impossible rung, rtol or combination, or a capture larger than the memory.
    """
    from ...generator.checked import checked
    from ...scenes.machine import memory_bytes
    from ...scenes.scene import sizes_of

    for item in items:
        where = item.scene.name
        checked(
            item.scene, seed=item.seed, capture_key=item.key or 0, fidelity=item.fidelity, rtol=item.rtol,
            truth_electrons=item.truth_electrons, truth_components=item.truth_components,
            truth_instances=item.truth_instances, name=_option,
        )  # fmt: skip
        slices, rows, cols = sizes_of(item.scene)
        needed = slices * (rows * cols * _BYTES_PER_SAMPLE + _BYTES_PER_SLICE)
        memory = memory_bytes()
        if needed > memory:
            raise InputError(
                "One capture does not fit into the memory of this machine, or of its control group.",
                where=f"{where}: {slices} × {rows} × {cols} samples",
                value=f"{needed / 2**30:.3g} GiB",
                allowed=f"{memory / 2**30:.3g} GiB",
                next_step="fewer delays, repeats, rows or columns, e.g. --set rig.delays.count=64",
            )


def _option(argument: str) -> str:
    """What the command line calls an argument."""
    return "--" + argument.replace("_", "-")


def planned(item: Item, name: str = "") -> dict[str, Any]:
    """The entry of a capture in a plan; `name` is that of the scene in its suite, which may hold one scene several times."""
    from ...scenes.scene import sizes_of

    slices, rows, cols = sizes_of(item.scene)
    return {
        "scene": name or item.scene.name,
        "seed": item.seed if item.seal is None else item.seal.number,
        "slices": slices,
        "rows": rows,
        "cols": cols,
        "bytes": 2 * slices * rows * cols,
        "fidelity": item.fidelity,
        "rtol": item.rtol,
    }
