"""Stores of captures: made, continued after an interruption, or made again from their own records and compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...scenes.errors import InputError
from .items import Item, check_items, planned
from .records import difference, recorded

if TYPE_CHECKING:
    import xarray as xr

    from ...captures.compare import Comparison
    from ..folders.progress import Progress
    from .large import Made

__all__ = ["Generated", "make_stores", "maker_of", "plan_of", "repeat_store"]


@dataclass(frozen=True)
class Generated:
    """What `generate` made, or with `plan` would make.

    `plan`: one entry per capture (scene, seed, sizes, bytes of the counts). `paths`: stores written. `comparison`: with
    `like`, one per capture; `differing` counts the values whose bits differ. `outline`, `made`: of a data set, its plan, and
    what was made; `script`: the file for Slurm.
    """

    plan: list[dict[str, Any]]
    paths: list[Path] = field(default_factory=list)
    comparison: list[Comparison] = field(default_factory=list)
    outline: dict[str, Any] | None = None
    made: Made | None = None
    script: Path | None = None

    @property
    def differing(self) -> int:
        """Number of values that differ from the store given as `like`."""
        return sum(item.differing for item in self.comparison)

    @property
    def equal(self) -> bool:
        """Equal bits and attributes in all captures compared."""
        return all(item.equal for item in self.comparison)


def plan_of(groups: Mapping[str, list[Item]]) -> list[dict[str, Any]]:
    """One entry per capture, for `Generated.plan`; the keys of `groups` are the names of scenes in their suite."""
    return [planned(item, name) for name, items in groups.items() for item in items]


def make_stores(
    groups: Mapping[str, list[Item]], paths: Mapping[str, Path], resume: bool, overwrite: bool, tell: Progress
) -> None:
    """Make the captures of each group and write them into the group's store.

    All existing outputs are checked before the first capture is made.

    Main arguments:
        groups, paths: Captures and store, by the group's name.
        resume: Keep complete stores, and continue unfinished ones.
        overwrite: Replace existing stores.
        tell: Receives the progress.

    Raises:
        InputError: A store exists (without `resume` and `overwrite`), or one to continue holds other captures.
    """
    from ...captures.store.publish import refuse_existing

    if not resume:
        for path in paths.values():
            refuse_existing(path, overwrite)
    finished = {name for name, items in groups.items() if resume and _complete(paths[name], items)}
    total = sum(map(len, groups.values()))
    done = 0
    for name, items in groups.items():
        if name not in finished:
            _write(paths[name], items, resume, overwrite, tell, done, total)
        done += len(items)


def _write(path: Path, items: list[Item], resume: bool, overwrite: bool, tell: Progress, done: int, total: int) -> None:
    from ...captures import CaptureWriter

    with CaptureWriter(path, overwrite=overwrite, resume=resume) as writer:
        _check_kept(str(writer.partial), [writer.attributes(index) for index in range(writer.count)], items)
        for position, item in enumerate(items):
            tell("generate", done + position, total, item.scene.name)
            if position >= writer.count:
                writer.append(_make(item))
        tell("generate", done + len(items), total, str(path))


def _complete(path: Path, items: list[Item]) -> bool:
    """Whether a complete store exists and holds exactly `items`. Raises InputError if it holds anything else."""
    from ...captures import open_captures
    from ...captures.store.publish import is_store, partial_of

    if not is_store(path) or is_store(partial_of(path)):
        return False  # nothing to keep, or begun again: the writer refuses what is in the way
    captures = open_captures(path)
    _check_kept(str(path), [captures.attributes(index) for index in range(len(captures))], items)
    if len(captures) < len(items):
        raise InputError(
            "The store is complete and holds fewer captures than requested.",
            where=str(path),
            value=len(captures),
            allowed=str(len(items)),
            next_step="choose another --out for the new captures, or give --overwrite",
        )
    return True


def _check_kept(where: str, kept: list[dict[str, Any]], items: list[Item]) -> None:
    """Refuse to continue a store whose captures are not the requested ones: it would mix two data sets."""
    for index, attrs in enumerate(kept):
        problem = difference(items[index], attrs) if index < len(items) else f"only {len(items)} captures are requested"
        if problem:
            raise InputError(
                f"The existing captures are not the requested ones: capture {index}: {problem}.",
                where=where,
                allowed="--resume with the same scene, seeds and options as before",
                next_step="choose another --out",
            )


def _make(item: Item) -> xr.Dataset:
    from ...captures.public import without_truth
    from ...captures.sources import bare_scene
    from ...generator.generate import capture_key_of
    from ...generator.generate import generate as make

    # The key does not depend on the folder of a mesh: the same scene file gives the same noise wherever it lies.
    key = capture_key_of(bare_scene(item.scene.model_dump(mode="json"))) if item.key is None else item.key
    capture = make(
        item.scene,
        seed=item.seed,
        capture_key=key,
        fidelity=item.fidelity,
        rtol=item.rtol,
        truth_electrons=item.truth_electrons,
        truth_components=item.truth_components,
        truth_instances=item.truth_instances,
    )
    return capture if item.seal is None else without_truth(capture, item.seal.provenance())


def maker_of(store: Path) -> Callable[[dict[str, Any], str], xr.Dataset]:
    """Makes a capture of a store again from its attributes; (attributes, place for messages) -> capture.

    Files of its scene are looked for beside the store and in the current folder. The capture raises InputError where its
    attributes do not say how it was made.
    """
    folders = (store.resolve().parent, Path.cwd())

    def make(attrs: dict[str, Any], where: str) -> xr.Dataset:
        item = recorded(attrs, where, folders, {})
        check_items([item])
        return _make(item)

    return make


def repeat_store(
    like: Path, places: Mapping[str, Any], plan: bool, out: Path | None, overwrite: bool, tell: Progress
) -> Generated:
    """Make a store again from the scene and the arguments that each capture records, and compare the captures.

    Main arguments:
        like: The store.
        places: Where files of its scene lie, {"target.0.shape.file": path}; else they are looked for beside the store and
            in the current folder.
    Other arguments:
        plan: Make nothing.
        out: Where the new captures are stored; None keeps none.
        overwrite: Replace an existing store there.
        tell: Receives the progress.
    """
    from ...captures import open_captures, write
    from ...captures.compare import compare_captures
    from ...captures.padding import padded_as

    captures = open_captures(like)
    folders = (like.resolve().parent, Path.cwd())
    items = [
        recorded(captures.attributes(index), f"{like}, capture {index}", folders, places)
        for index in range(len(captures))
    ]
    check_items(items)
    outline = [planned(item) for item in items]
    if plan:
        return Generated(outline)
    comparison = []

    def again() -> Iterator[xr.Dataset]:
        for index, item in enumerate(items):
            tell("generate", index, len(items), item.scene.name)
            stored = captures[index]
            capture = padded_as(stored, _make(item), f"{like}, capture {index}")
            comparison.append(compare_captures(stored, capture))
            yield capture
        tell("generate", len(items), len(items), "")

    if out is None:
        for _ in again():
            pass
        return Generated(outline, [], comparison)
    return Generated(outline, [write(out, again(), overwrite=overwrite)], comparison)
