"""`beambench generate`: captures of a scene or of a suite, or the repetition of a store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ..output import default_out

if TYPE_CHECKING:
    from ..benchmarks.datasets.generate import Generated
    from ..benchmarks.datasets.items import Item
    from ..benchmarks.folders.progress import Progress
    from ..scenes.scene import Scene

__all__ = ["generate"]


def generate(
    source: str | Path | Mapping[str, Any] | Scene | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    rig: str | Path | None = None,
    seeds: Sequence[int] | None = None,
    fidelity: Literal["direct", "scatter", "full", "geometric", "isolated", "coherent", "auto"] | None = None,
    rtol: float | Literal["noise"] | None = None,
    truth_electrons: bool = False,
    truth_components: bool = False,
    sealed: str | Path | None = None,
    like: str | Path | None = None,
    plan: bool = False,
    workers: int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Generated:
    """Generate captures with exact truth from a scene, a suite or a data set, and store them.

    The captures of a scene, one per seed, go into one store; those of a data set, whose parameters are drawn, too. Those of a
    suite, its test captures without stress, go into one store per scene, inside the folder `out`.

    Main arguments:
        source: Name of a scene, a suite or a data set, or a .toml or .json file; in Python also a scene or a data set as data.
        overrides: {path: value}, applied before validation.
    Other arguments:
        rig: A rig file, as `beambench calibrate` writes it, whose values the scene's rig gets; those of `overrides` stand over it.
        seeds: Seed of a scene's capture, a whole number; 0 by default. A suite and a data set have seeds of their own.
        fidelity: Rung of the forward model, the suite's or the cheapest by default; auto: the cheapest with an error below `rtol`.
        rtol: Largest relative error of the expected counts; the suite's or 1e-3 by default. With `fidelity` auto also
            "noise": below one standard deviation of the detector's noise, and too small to bias the answer.
        truth_electrons: Store the noise-free expectation of every sample, too.
        truth_components: Store the parts of the light, too: direct, reflected between surfaces, scattered once, scattered
            repeatedly (`truth_direct`, `truth_interreflection`, `truth_single`, `truth_multiple`). Needs `fidelity` full.
        sealed: File of a secret key: captures of a suite with seeds that nobody knows, without truth (docs/challenges.md).
        like: Repeat this store from its own records and compare the captures value by value; the exit code is 1 if any
            differs. The new captures are stored only if `out` is given. No option may change what is made; `overrides` may say
            where a file of the scene lies (target.0.shape.file=PATH) that is neither beside the store nor in this folder.
        plan: List the captures without making any; of a data set, tell its size, time, shards and parts, by a pilot.
        workers: Processes that make a data set; one for each processor by default. Captures are the same for any number.
        out: Where to write; ./beambench-runs/<name>-<time> by default.
        resume: Continue an unfinished store, keep complete ones, let a data set grow; existing captures must be the requested ones.
        overwrite: Replace an existing output.
        progress: Receives every step.

    Returns `plan` (one per capture), `paths`, of a data set `outline`, `made`; with `like` `comparison`, `differing`, `equal`.

    Raises:
        InputError: Bad input, an output that exists, or one to resume that holds other captures.
    """
    from ..scenes.places import local_path

    place, changes = None if out is None else local_path(out), dict(overrides or {})
    given: dict[str, Any] = {
        "a scene or suite": source, "--rig": rig, "--seeds": seeds, "--fidelity": fidelity, "--rtol": rtol, "--workers": workers,
        "--truth-electrons": truth_electrons, "--truth-components": truth_components, "--sealed": sealed, "--resume": resume,
    }  # fmt: skip
    if like is not None:
        return _repeat(like, given, changes, plan, place, overwrite, progress)
    return _made_of(
        source, _of_rig(rig, source) | changes, given, _How(plan, workers, place, resume, overwrite, progress)
    )


def _of_rig(rig: str | Path | None, source: Any) -> dict[str, Any]:
    """{path: value} of a rig file for a scene. Raises InputError for another kind of rig, a suite or a data set."""
    from ..scenes.datasets.load import is_dataset
    from ..scenes.errors import InputError
    from ..scenes.load import load_scene
    from ..scenes.rig_files import read_rig_file

    if rig is None:
        return {}
    if is_dataset(source):
        raise InputError(
            "A rig file goes into a scene.", where="--rig", value=str(rig), allowed="a scene as the source"
        )
    return read_rig_file(rig, load_scene(source).modality).overrides()


@dataclass(frozen=True)
class _How:
    """Where and how captures are made: arguments of `generate`."""

    plan: bool
    workers: int | None
    out: Path | None
    resume: bool
    overwrite: bool
    progress: Progress | None


def _made_of(source: Any, changes: dict[str, Any], given: dict[str, Any], how: _How) -> Generated:
    from ..benchmarks.datasets.items import items_of
    from ..benchmarks.suites.sealed import read_key
    from ..scenes.datasets.load import is_dataset
    from ..scenes.errors import InputError

    _check_request(source, how.out, how.resume, how.overwrite)
    key = None if given["--sealed"] is None else read_key(given["--sealed"])
    names = ("fidelity", "rtol", "truth_electrons", "truth_components")
    asked = {name: given["--" + name.replace("_", "-")] for name in names}
    if is_dataset(source) and key is not None:
        raise InputError("Only a suite can be sealed.", where="--sealed", value=str(source), next_step="name a suite")
    if is_dataset(source):
        own = {name: value for name, value in asked.items() if value is not None and value is not False}
        return _data_set(source, changes | own, given["--seeds"], how)
    if how.workers is not None:
        raise InputError("Only a data set is made by several workers.", where="--workers", value=how.workers)
    rung, rtol, electrons, components = asked.values()
    groups = items_of(source, changes, given["--seeds"], rung, rtol, electrons, components, key)
    return _make(str(source), groups, how.plan, how.out, how.resume, how.overwrite, how.progress)


def _data_set(source: Any, changes: dict[str, Any], seeds: Any, how: _How) -> Generated:
    from ..benchmarks.datasets.generate import Generated
    from ..benchmarks.datasets.large import make_dataset
    from ..benchmarks.datasets.outline import outline
    from ..benchmarks.folders.progress import silent
    from ..scenes.datasets.load import load_dataset
    from ..scenes.errors import InputError

    if seeds is not None:
        raise InputError(
            "A data set has a seed of its own.", where="--seeds", value=seeds, next_step="change it with --set seed=2"
        )
    draws = load_dataset(source, changes)
    place = how.out or default_out(draws.data.dataset)
    if how.plan:
        return Generated([], outline=outline(draws, place, how.workers))
    made = make_dataset(
        draws, place, workers=how.workers, resume=how.resume, overwrite=how.overwrite, tell=how.progress or silent
    )
    return Generated([], [made.path], made=made)


def _make(
    source: str,
    groups: dict[str, list[Item]],
    plan: bool,
    out: Path | None,
    resume: bool,
    overwrite: bool,
    progress: Progress | None,
) -> Generated:
    from ..benchmarks.datasets.generate import Generated, make_stores, plan_of
    from ..benchmarks.folders.progress import silent

    if plan:
        return Generated(plan_of(groups))
    single = len(groups) == 1 and "" in groups
    base = out or default_out(groups[""][0].scene.name if single else source)
    paths = {name: base if single else base / f"{name}.zarr" for name in groups}
    make_stores(groups, paths, resume, overwrite, progress or silent)
    return Generated(plan_of(groups), list(paths.values()))


def _repeat(
    like: str | Path, given: dict[str, Any], places: dict[str, Any], plan: bool, out: Path | None, overwrite: bool,
    progress: Progress | None,
) -> Generated:  # fmt: skip
    """Repeat the store `like`, unless one of the options in `given` would change what is made."""
    from ..benchmarks.datasets.generate import repeat_store
    from ..benchmarks.folders.progress import silent
    from ..scenes.errors import InputError

    names = [name for name, value in given.items() if value is not None and value is not False]
    if names:
        raise InputError(
            "The option --like repeats a store from its own records, which cannot be changed.",
            where="--like",
            value=", ".join(names),
            allowed="--plan, --out, --overwrite, and --set with the path of a file of its scene",
            next_step="leave them out, or generate from the scene",
        )
    return repeat_store(Path(like).expanduser(), places, plan, out, overwrite, progress or silent)


def _check_request(source: Any, out: Path | None, resume: bool, overwrite: bool) -> None:
    from ..scenes.errors import InputError

    if source is None:
        raise InputError("Give either a scene or suite, or --like STORE.", where="generate", allowed="one of the two")
    if resume and overwrite:
        raise InputError("Both --resume and --overwrite are given.", where="--resume", allowed="one of them")
    if resume and out is None:
        raise InputError(
            "The option --resume needs the store to continue.",
            where="--out",
            next_step="add --out STORE, an earlier output",
        )
