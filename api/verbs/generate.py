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
    from ..scenes.datasets.draws import Draws
    from ..scenes.scene import Scene

__all__ = ["generate"]

#: Options of which only a data set has a use: who makes it, and how.
_FORCE = ("--workers", "--time-limit-s", "--dask", "--slurm", "--array", "--job")


def generate(
    source: str | Path | Mapping[str, Any] | Scene | None = None, *,
    overrides: Mapping[str, Any] | None = None, rig: str | Path | None = None, seeds: Sequence[int] | None = None,
    fidelity: Literal["direct", "scatter", "full", "geometric", "isolated", "coherent", "auto"] | None = None,
    rtol: float | Literal["noise"] | None = None, truth_electrons: bool = False, truth_components: bool = False,
    truth_instances: bool = False, sealed: str | Path | None = None, like: str | Path | None = None, plan: bool = False,
    workers: int | None = None, time_limit_s: float | None = None, dask: str | None = None, slurm: str | Path | None = None,
    array: int | None = None, job: str | None = None, out: str | Path | None = None, resume: bool = False, overwrite: bool = False,
    progress: Progress | None = None,
) -> Generated:  # fmt: skip
    """Generate captures with exact truth from a scene, a suite or a data set, and store them.

    Those of a scene, one per seed, and of a data set go into one store; a suite's, without stress, into one per scene in `out`.

    Main arguments:
        source: Name of a scene, a suite or a data set, or a .toml or .json file; in Python also a scene or a data set as data.
        overrides: {path: value}, applied before validation.
    Other arguments:
        rig: A rig file of `beambench calibrate`, whose values the scene's rig gets; those of `overrides` stand over it.
        seeds: Seed of a scene's capture, a whole number; 0 by default. A suite and a data set have seeds of their own.
        fidelity: Rung of the forward model, the suite's or the cheapest by default; auto: the cheapest with an error below `rtol`.
        rtol: Largest relative error of the expected counts; the suite's or 1e-3 by default. With `fidelity` auto also
            "noise": below one standard deviation of the detector's noise, and too small to bias the answer.
        truth_electrons: Store the noise-free expectation of every sample, too.
        truth_components: Store what the light is the sum of, too (`truth_direct`, `truth_ambient`, …; docs/procedural-shapes.md).
        truth_instances: Store which piece of the target each pixel sees, too (`truth_instance`).
        sealed: File of a secret key: captures of a suite with seeds that nobody knows, without truth (docs/challenges.md).
        like: Repeat this store from its own records and compare the captures value by value; the exit code is 1 if any
            differs. The new captures are stored only if `out` is given. No option may change what is made; `overrides` may say
            where a file of the scene lies (target.0.shape.file=PATH) that is neither beside the store nor in this folder.
        plan: List the captures without making any; of a data set, tell its size, time, shards and parts, by a pilot.
        workers: Processes that make a data set; one for each processor by default. Captures are the same for any number.
        time_limit_s: Time after which a worker that completes no capture is replaced, s; 60 s or more by default.
        dask: Address of a Dask scheduler, tcp://HOST:PORT, whose workers make a data set in a folder that all share.
        slurm: Begin the data set, and write a script for Slurm there that makes it as an array of jobs.
        array: Number of jobs of that array; one for each shard by default, at most 1000.
        job: Make part K of N of a data set that was begun, as K/N; the jobs of an array do this.
        out: Where to write; ./beambench-runs/<name>-<time> by default.
        resume: Continue an unfinished store, keep complete ones, let a data set grow; existing captures must be the requested ones.
        overwrite: Replace an existing output.
        progress: Receives every step.

    Returns `plan`, `paths`, of a data set `outline`, `made`, `script`; with `like` `comparison`, `differing`, `equal`.
    Raises InputError: bad input, an output that exists, or one to resume that holds other captures.
    """
    place, changes = _place(out), dict(overrides or {})
    force = dict(zip(_FORCE, (workers, time_limit_s, dask, slurm, array, job), strict=True))
    given: dict[str, Any] = {
        "a scene or suite": source, "--rig": rig, "--seeds": seeds, "--fidelity": fidelity, "--rtol": rtol, "--sealed": sealed,
        "--resume": resume, "--truth-electrons": truth_electrons, "--truth-components": truth_components,
        "--truth-instances": truth_instances, **force,
    }  # fmt: skip
    if like is not None:
        return _repeat(like, given, changes, plan, place, overwrite, progress)
    return _made_of(
        source, _of_rig(rig, source) | changes, given, _How(plan, force, place, resume, overwrite, progress)
    )


def _place(out: str | Path | None) -> Path | None:
    from ..scenes.places import local_path

    return None if out is None else local_path(out)


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
    force: dict[str, Any]
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
    names = ("fidelity", "rtol", "truth_electrons", "truth_components", "truth_instances")
    asked = {name: given["--" + name.replace("_", "-")] for name in names}
    if is_dataset(source) and key is not None:
        raise InputError("Only a suite can be sealed.", where="--sealed", value=str(source), next_step="name a suite")
    if is_dataset(source):
        own = {name: value for name, value in asked.items() if value is not None and value is not False}
        return _data_set(source, changes | own, given["--seeds"], how)
    for name, value in how.force.items():
        if value is not None:
            raise InputError("Only a data set is made by several workers.", where=name, value=value)
    rung, rtol, electrons, components, instances = asked.values()
    groups = items_of(source, changes, given["--seeds"], rung, rtol, electrons, components, instances, key)
    return _make(str(source), groups, how.plan, how.out, how.resume, how.overwrite, how.progress)


def _data_set(source: Any, changes: dict[str, Any], seeds: Any, how: _How) -> Generated:
    from ..benchmarks.datasets.generate import Generated
    from ..benchmarks.datasets.kept import kept_note
    from ..benchmarks.datasets.large import Force, make_dataset, make_part
    from ..benchmarks.datasets.outline import outline
    from ..benchmarks.datasets.slurm import part_of
    from ..benchmarks.folders.progress import silent
    from ..scenes.datasets.load import load_dataset
    from ..scenes.errors import InputError

    if seeds is not None:
        raise InputError(
            "A data set has a seed of its own.", where="--seeds", value=seeds, next_step="change it with --set seed=2"
        )
    draws = load_dataset(source, changes)
    place, workers = how.out or default_out(draws.data.dataset), how.force["--workers"]
    _check_force(how)
    if how.plan:
        return Generated([], outline=outline(draws, place, workers))
    if how.force["--slurm"] is not None:
        return _array(source, changes, draws, place, how)
    force, tell = Force(workers, how.force["--dask"], how.force["--time-limit-s"]), how.progress or silent
    if how.force["--job"] is not None:
        return Generated([], [place], made=make_part(draws, place, part_of(how.force["--job"]), force, tell))
    try:
        made = make_dataset(draws, place, force, resume=how.resume, overwrite=how.overwrite, tell=tell)
    except KeyboardInterrupt as error:
        if note := kept_note(source, changes, place):
            error.add_note(note)
        raise
    return Generated([], [made.path], made=made)


def _check_force(how: _How) -> None:
    """Refuse options of which one excludes the other. Raises InputError."""
    from ..scenes.errors import InputError

    given = {name for name, value in how.force.items() if value is not None}
    for one, *others in (
        ("--dask", "--workers", "--slurm", "--job"),
        ("--slurm", "--workers", "--job"),
        ("--job", "--array"),
    ):
        if one in given and (both := given & {*others}):
            raise InputError("These options exclude each other.", where=one, value=", ".join(sorted(both)))
    if "--array" in given and "--slurm" not in given:
        raise InputError(
            "The number of an array's jobs needs the script.", where="--array", next_step="add --slurm FILE"
        )
    if "--job" in given and (how.resume or how.overwrite or how.plan or how.out is None):
        raise InputError(
            "A part of a data set is made in a store that was begun.", where="--job",
            allowed="with --out, and without --resume, --overwrite and --plan", next_step="begin it by --slurm FILE",
        )  # fmt: skip
    limit = how.force["--time-limit-s"]
    if limit is not None and not 0.0 < limit < float("inf"):
        raise InputError(
            "The limit of time is a positive number.", where="--time-limit-s", value=limit, allowed="> 0 s"
        )


def _array(source: Any, changes: dict[str, Any], draws: Draws, place: Path, how: _How) -> Generated:
    """Begin a data set and write the script of its array of jobs."""
    from ..benchmarks.datasets.generate import Generated
    from ..benchmarks.datasets.large import begin_dataset
    from ..benchmarks.datasets.slurm import array_size, script_text
    from ..benchmarks.folders.files import write_text
    from ..scenes.errors import InputError
    from ..scenes.places import local_path

    if not isinstance(source, str | Path):
        raise InputError("An array of jobs needs a data set that has a name or a file.", where="--slurm", value="data")
    file = local_path(how.force["--slurm"])
    if file.exists() and not (how.resume or how.overwrite):
        raise InputError("The script exists.", where=str(file), next_step="--resume or --overwrite replaces it")
    word = str(Path(source).absolute()) if Path(source).is_file() else str(source)
    made = begin_dataset(draws, place, resume=how.resume, overwrite=how.overwrite)
    tasks = array_size(how.force["--array"], made.missing)
    write_text(file, script_text(draws.data.dataset, word, changes, place, tasks))
    return Generated([], [place], made=made, script=file)


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
