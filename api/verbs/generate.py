"""`beambench generate`: captures of a scene or of a suite's cells, or the repetition of a store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..output import default_out
from .generate_items import Fidelity, Item, Rtol, check_items, difference, items_of, planned, recorded

if TYPE_CHECKING:
    import xarray as xr

    from ..benchmarks.folders.progress import Progress
    from ..captures.compare import Comparison
    from ..scenes.scene import Scene

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


def generate(
    source: str | Path | Mapping[str, Any] | Scene | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    fidelity: Fidelity | None = None,
    rtol: Rtol | None = None,
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
        seeds: for a scene; 0 by default. A suite has its own.
        fidelity, rtol: rung of the forward model, and the relative error aimed at; by default the suite's, or "direct"
            and 1e-3. rtol "noise", for fidelity "auto": below one standard deviation of the detector's noise.
        truth_electrons: keep the noise-free expectation of each sample as well.
        truth_components: keep the stacks that the lamp's light is the sum of as well: `truth_direct`,
            `truth_interreflection`, `truth_single` and `truth_multiple`; with fidelity "full" of gated scenes only.
        like: a store to repeat from its own records; the new captures are compared with it value by value, and written
            only if `out` is given. Files of its scene are looked for beside it and in the current folder, or where
            `overrides` tells, e.g. {"target.0.shape.file": path}; their sha256 is compared first.
        plan: tell what would be made, and make nothing.
        out: where to write. resume: go on with an unfinished store, and leave complete ones as they are; all that is
            there must be what is asked for. overwrite: replace what is there.

    Raises:
        InputError: bad input, an output that exists, or one to resume that holds other captures.
    """
    from ..benchmarks.folders.progress import silent
    from ..captures.store.publish import refuse_existing

    tell = progress or silent
    if like is not None:
        given = {
            "a scene or suite": source, "--seeds": seeds, "--fidelity": fidelity, "--rtol": rtol,
            "--truth-electrons": truth_electrons, "--truth-components": truth_components, "--resume": resume,
        }  # fmt: skip
        _refuse_beside_like([name for name, value in given.items() if value is not None and value is not False])
        return _repeat(Path(like).expanduser(), dict(overrides or {}), plan, out, overwrite, tell)
    _check_request(source, out, resume, overwrite)
    groups = items_of(source, dict(overrides or {}), seeds, fidelity, rtol, truth_electrons, truth_components)
    outline = [planned(item, name) for name, items in groups.items() for item in items]
    if plan:
        return Generated(outline)
    single = len(groups) == 1 and "" in groups
    base = (
        Path(out).expanduser()
        if out is not None
        else default_out(next(iter(groups.values()))[0].scene.name if single else str(source))
    )
    paths = {name: base if single else base / f"{name}.zarr" for name in groups}
    # All that is there is looked at before the first capture is made.
    for path in paths.values():
        if not resume:
            refuse_existing(path, overwrite)
    finished = {name for name, items in groups.items() if resume and _complete(paths[name], items)}
    done = 0
    for name, items in groups.items():
        if name not in finished:
            _write(paths[name], items, resume, overwrite, tell, done, len(outline))
        done += len(items)
    return Generated(outline, list(paths.values()))


def _refuse_beside_like(names: list[str]) -> None:
    from ..scenes.errors import InputError

    if names:
        raise InputError(
            "--like repeats a store from its own records; nothing of them can be changed.",
            where="--like",
            value=", ".join(names),
            allowed="--plan, --out, --overwrite, and --set for where a file of its scene lies",
            next_step="leave them out, or generate from the scene",
        )


def _check_request(source: Any, out: str | Path | None, resume: bool, overwrite: bool) -> None:
    from ..scenes.errors import InputError

    if source is None:
        raise InputError("Give either a scene or suite, or --like STORE.", where="generate", allowed="one of the two")
    if resume and overwrite:
        raise InputError("Both --resume and --overwrite are given.", where="--resume", allowed="one of them")
    if resume and out is None:
        raise InputError(
            "--resume needs the store to go on with.", where="--out", next_step="add --out STORE, an earlier output"
        )


def _write(path: Path, items: list[Item], resume: bool, overwrite: bool, tell: Progress, done: int, total: int) -> Path:
    from ..captures import CaptureWriter

    with CaptureWriter(path, overwrite=overwrite, resume=resume) as writer:
        _check_kept(str(writer.partial), [writer.attributes(index) for index in range(writer.count)], items)
        for position, item in enumerate(items):
            tell("generate", done + position, total, item.scene.name)
            if position >= writer.count:
                writer.append(_make(item))
        tell("generate", done + len(items), total, str(path))
    return path


def _complete(path: Path, items: list[Item]) -> bool:
    """Whether the store is there in full and holds exactly `items`. Raises InputError where it holds anything else."""
    from ..captures import open_captures
    from ..captures.store.publish import is_store, partial_of
    from ..scenes.errors import InputError

    if not is_store(path) or is_store(partial_of(path)):
        return False  # nothing to go on with, or begun anew: the writer tells what is in the way
    captures = open_captures(path)
    _check_kept(str(path), [captures.attributes(index) for index in range(len(captures))], items)
    if len(captures) < len(items):
        raise InputError(
            "The store is complete and holds fewer captures than are asked for.",
            where=str(path),
            value=len(captures),
            allowed=str(len(items)),
            next_step="choose another --out for the new captures, or give --overwrite",
        )
    return True


def _check_kept(where: str, kept: list[dict[str, Any]], items: list[Item]) -> None:
    """Refuse to go on with captures that are not the ones asked for: a store would mix two data sets."""
    from ..scenes.errors import InputError

    for index, attrs in enumerate(kept):
        found = difference(items[index], attrs) if index < len(items) else f"only {len(items)} captures are asked for"
        if found:
            raise InputError(
                f"What is there is not what is asked for: capture {index}: {found}.",
                where=where,
                allowed="--resume with the same scene, seeds and options as before",
                next_step="choose another --out",
            )


def _make(item: Item) -> xr.Dataset:
    from ..captures.sources import bare_scene
    from ..generator.generate import capture_key_of
    from ..generator.generate import generate as make

    # The folder of a mesh has no part in the key: the same scene file gives the same noise wherever it lies.
    key = capture_key_of(bare_scene(item.scene.model_dump(mode="json"))) if item.key is None else item.key
    return make(
        item.scene,
        seed=item.seed,
        capture_key=key,
        fidelity=item.fidelity,
        rtol=item.rtol,
        truth_electrons=item.truth_electrons,
        truth_components=item.truth_components,
    )


def _repeat(
    like: Path, given: dict[str, Any], plan: bool, out: str | Path | None, overwrite: bool, tell: Progress
) -> Generated:
    """Make a store again from the scene and the arguments that each capture records, and compare."""
    from ..captures import open_captures, write
    from ..captures.compare import compare_captures

    captures = open_captures(like)
    places = (like.resolve().parent, Path.cwd())
    items = [
        recorded(captures.attributes(index), f"{like}, capture {index}", places, given)
        for index in range(len(captures))
    ]
    check_items(items)
    outline = [planned(item) for item in items]
    if plan:
        return Generated(outline)
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
        return Generated(outline, [], comparison)
    path = write(Path(out).expanduser(), remade(), overwrite=overwrite)
    return Generated(outline, [path], comparison)
