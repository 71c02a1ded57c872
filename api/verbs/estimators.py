"""`beambench estimators list|check|new|train`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..output import check_free, claim

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress
    from ..benchmarks.laws.check import Check

__all__ = ["estimators_check", "estimators_list", "estimators_new", "estimators_train"]


def estimators_list() -> list[dict[str, Any]]:
    """List the installed estimators, with their parameters and sources.

    Plug-ins are included. Each is imported in a process of its own, in the jail of a run, for at most 30 s; one that cannot be
    imported is listed with the reason.

    Returns:
        One record per estimator: name, modality, parameters with defaults, cites, origin, summary, error.
    """
    from ..benchmarks.runner.confined import plugin_row
    from ..estimators.listing import listed

    return listed(plugin_row)


def estimators_check(
    estimator: str, *, compare: bool = True, chart: str | Path | None = None, overwrite: bool = False,
    progress: Progress | None = None,
) -> Check:  # fmt: skip
    """Check an estimator against the laws that every estimator obeys, and compare it with the built-in ones of its stage.

    The laws, on a small synthetic capture: it answers, repeats itself, does not change its input, follows a shift of the delays and
    a change of the gain, does not depend on the order of pixels, states errors that hold the scatter of its answers, and returns
    finite or invalid results near every singularity. The exit code is 1 if one is broken. Then its place: error, stated error and
    CPU time beside those of the built-in estimators on the same captures, and from which light and background on a tenth of its
    answers fail. A plug-in is tried in a process of its own, in the jail of a run: if it ends that process, or takes longer than
    120 s for a law, it breaks that law.

    Main arguments:
        estimator: The estimator, as name or name[key=value,...].
    Other arguments:
        compare: Whether to compare it with the built-in estimators, which takes about half a minute.
        chart: File of a chart of speed against accuracy, a picture (.png) or a page (.html).
        overwrite: Replace an existing chart.
        progress: Receives every law and every answer.

    Returns:
        `laws`: one result per law, with `law`, `holds`, `seen`. `place`: the comparison, with `standings`, `breakdowns`, `bound`
        and `why` there is none; None without one.

    Raises:
        InputError: No such estimator or parameter, there are no laws for its stage, or a chart that cannot be written.
    """
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.laws.check import Check, laws_record, own_laws
    from ..benchmarks.laws.trial import try_laws
    from ..benchmarks.runner.confined import plugin_row
    from ..benchmarks.runner.estimator_labels import check_estimators
    from ..estimators import parse_label
    from ..estimators.chain import is_built_in
    from ..estimators.listing import described

    picture = None if chart is None else _chart_path(chart, compare=compare, overwrite=overwrite)
    name, _ = parse_label(estimator)
    told = progress or silent
    laws = own_laws(estimator, told) if is_built_in(name) else try_laws(estimator, progress=told)
    if not compare:
        return Check(laws, None)
    from ..benchmarks.laws.place import placed

    (chosen,) = check_estimators([estimator])
    own = described(name, plugin_row)
    place = placed(chosen.label, own, laws_record(own.stage), told)
    if picture is not None and not place.why:
        from ..benchmarks.report.place_chart import save_place

        save_place(place, chosen.label, picture)
    return Check(laws, place)


def _chart_path(chart: str | Path, *, compare: bool, overwrite: bool) -> Path:
    """The file of a chart, checked before anything runs."""
    from ..benchmarks.report.place_chart import check_chart_path
    from ..scenes.errors import InputError
    from ..scenes.places import local_path

    if not isinstance(chart, str | Path):
        raise InputError("A chart is written to a file.", where="chart", value=chart, allowed="a path, as place.png")
    if not compare:
        raise InputError(
            "A chart shows the comparison, which is left out.", where="chart", value=str(chart), allowed="with compare"
        )
    path = local_path(chart)
    check_chart_path(path)
    check_free(path, overwrite=overwrite)
    return path


def estimators_new(
    name: str, *, stage: str | None = None, out: str | Path | None = None, overwrite: bool = False
) -> Path:
    """Write a small package with a working estimator of your own, its entry point and its test.

    Main arguments:
        name: Lower-case letters, digits and dashes, e.g. my-median.
    Other arguments:
        stage: What the estimator reads and gives, a word of `@estimator`, as "line": a finder of laser lines. Every stage has a
            template; the first one, the range from gated images, is the default.
        out: Folder of the package; ./beambench-runs/<name>-<time> by default.
        overwrite: Replace the files of an earlier package.

    Returns:
        The folder.

    Raises:
        InputError: A name that cannot be used or is taken, an unknown stage, or an output that exists.
    """
    from ..estimators.package import check_name, is_package, template_of, write_package

    check_name(name)
    template = template_of(stage)
    folder = claim(out, name, overwrite=overwrite, ours=is_package)
    write_package(folder, name, template)
    return folder


def estimators_train(
    data: str | Path | Sequence[str | Path],
    *,
    out: str | Path,
    units: int = 96,
    ridge: float = 1e-5,
    seed: int = 1,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, float]:
    """Train the learned estimator on stored captures. Use the weights as 'learned[weights=FILE]'.

    Main arguments:
        data: A store of captures with truth, of the modality that `learned` reads, or a folder of such stores.
        out: The weights, an .npz file.
    Other arguments:
        units: Number of units of the one layer.
        ridge: Penalty of the linear solve.
        seed: Random seed of the layer and of the split of the data.
        overwrite: Replace an existing file.
        progress: Receives every capture that is read, then the pixels that are fitted.

    Returns:
        Numbers of captures and pixels, the rms error on pixels held out and that of the first guess (both in units of the
        standard deviation of the response), and the size of the file in bytes.

    Raises:
        InputError: Data that cannot be used, or an output that exists.
    """
    from ..benchmarks.folders.progress import silent
    from ..estimators import train
    from ..scenes.errors import InputError
    from ..scenes.places import local_path

    paths = [data] if isinstance(data, str | Path) else data
    if not isinstance(paths, Sequence) or not paths or not all(isinstance(path, str | Path) for path in paths):
        raise InputError(
            "Training data are given by their paths.", where="data", value=data, allowed="a path, or a list of paths",
            next_step="beambench generate learned-training -o training",
        )  # fmt: skip
    if not isinstance(out, str | Path):
        raise InputError("The weights are written to a file.", where="out", value=out, allowed="a path, as w.npz")
    check_free(out, overwrite=overwrite)
    return train(paths, local_path(out), units=units, ridge=ridge, seed=seed, tell=progress or silent)
