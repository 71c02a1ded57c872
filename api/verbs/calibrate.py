"""`beambench calibrate`: the values of a rig, with their standard errors, from captures of a calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from ..output import claim

if TYPE_CHECKING:
    import xarray as xr

    from ..captures import CaptureSet
    from ..estimators.calibration.procedure import Calibrated, Procedure
    from ..scenes.rig_files import RigFile

__all__ = ["Calibration", "calibrate"]


@dataclass(frozen=True)
class Calibration:
    """What each procedure found, by its name, why others were not run, the rig file's content, and its path."""

    found: dict[str, Calibrated]
    lacking: dict[str, str]
    rig: RigFile
    out: Path


def calibrate(
    data: Sequence[str | Path],
    *,
    procedures: Sequence[str] | None = None,
    rig: str | Path | None = None,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Calibration:
    """Find the values of a rig from captures of a calibration, and write them as a rig file.

    Every procedure for which the captures hold what it needs is run. docs/calibration.md shows the captures of each.

    Main arguments:
        data: Stores of captures of one rig.
        procedures: Procedure to run, instead of all that the captures allow: emva1288, delay-scan, boards, lenslets; with what it
            must be told as NAME[KEY=VALUE,...].
        rig: A rig file that the values go into; a new one by default.
    Other arguments:
        out: The rig file, .toml; ./beambench-runs/rig-<name>-<time>.toml by default.
        overwrite: Replace an existing rig file.

    Returns:
        `found` {procedure: figures}, `lacking` {procedure: why it was not run}, `rig`, and `out`.

    Raises:
        InputError: No store, captures of several kinds of rigs, an unknown procedure, captures that no procedure can use, or an
            output that exists.
    """
    from ..captures import open_captures
    from ..estimators.calibration.procedure import PROCEDURES, procedure_of
    from ..estimators.labels import each_label
    from ..scenes.errors import InputError
    from ..scenes.places import local_path
    from ..scenes.rig_files import RigFile, read_rig_file, write_rig_file

    stores = [data] if isinstance(data, str | Path) else list(data)
    if not stores:
        raise InputError("No captures are named.", where="DATA", next_step="beambench calibrate --help")
    captures = _Hidden([open_captures(store) for store in stores])
    kind = captures.kind(stores)
    base = None if rig is None else read_rig_file(rig, kind)
    labels = each_label([procedures] if isinstance(procedures, str) else procedures or PROCEDURES)
    asked = [procedure_of(label) for label in labels]
    lacking = {one.name: one.lacking(captures) for one in asked}
    _check_some(asked, lacking, strict=bool(procedures))
    name = f"rig-{Path(stores[0]).stem}.toml"
    place = local_path(out) if out is not None else None
    path = claim(place, name, overwrite=overwrite, ours=_is_rig_file, inputs=list(stores))
    path = path if place is not None else path.with_name(f"{path.name}.toml")
    found = {one.name: one.run(captures) for one in asked if not lacking[one.name]}
    for procedure, made in found.items():
        values, sigmas = _values(made)
        record = {"procedure": procedure, "data": [Path(store).name for store in stores], **made.used}
        start = base if base is not None else RigFile.model_construct(kind=kind, rig={})
        base = start.updated(values, sigmas, record)
    assert base is not None
    write_rig_file(path, base)
    return Calibration(found, {name: why for name, why in lacking.items() if why}, base, path)


def _check_some(asked: Sequence[Procedure], lacking: dict[str, str], *, strict: bool) -> None:
    from ..scenes.errors import InputError

    missing = {name: why for name, why in lacking.items() if why}
    # A procedure that needs no other captures, but what a user must state, says so after a colon.
    typed = [rest for why in missing.values() if "--procedures" in (rest := why.partition(": ")[2])]
    if len(missing) == len(asked) or (missing and strict):
        raise InputError(
            "The captures do not hold what a calibration needs.", where="DATA",
            value="; ".join(f"{name} lacks {why.partition(': type')[0]}" for name, why in missing.items()),
            next_step=typed[0] if typed else "docs/calibration.md shows the captures of each procedure",
        )  # fmt: skip


def _values(made: Calibrated) -> tuple[dict[str, Any], dict[str, float]]:
    import math

    shown = [one for one in made.figures if one.path]
    # Lists stand before their elements, which are the same numbers.
    values = dict(made.values) | {one.path: one.value for one in shown if one.path not in made.values}
    sigmas = {one.path: one.sigma for one in shown if math.isfinite(one.sigma)} | dict(made.sigmas)
    return values, sigmas


def _is_rig_file(path: Path) -> bool:
    from ..scenes.errors import InputError
    from ..scenes.rig_files import read_rig_file

    try:
        read_rig_file(path)
    except InputError:
        return path.is_file() and path.stat().st_size == 0
    return True


class _Hidden(Sequence["xr.Dataset"]):
    """The captures of several stores without their truth but for surveyed ranges, read when they are asked for."""

    def __init__(self, stores: Sequence[CaptureSet]) -> None:
        self._at = [(store, index) for store in stores for index in range(len(store))]
        self._stores = stores

    def kind(self, names: Sequence[str | Path]) -> str:
        """The modality of all. Raises InputError where there are several."""
        from ..scenes.errors import InputError

        kinds = [str(store[0].attrs["modality"]) for store in self._stores]
        if len({*kinds}) > 1:
            raise InputError(
                "The stores are of several kinds of rigs.", where="DATA",
                value=dict(zip(map(str, names), kinds, strict=True)), allowed="captures of one rig",
            )  # fmt: skip
        return kinds[0]

    def __len__(self) -> int:
        return len(self._at)

    @overload
    def __getitem__(self, index: int) -> xr.Dataset: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[xr.Dataset]: ...
    def __getitem__(self, index: int | slice) -> xr.Dataset | Sequence[xr.Dataset]:
        from ..captures.hide import hide_truth_but_ranges

        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        store, number = self._at[index]
        return hide_truth_but_ranges(store[number])

    def __iter__(self) -> Iterator[xr.Dataset]:
        return (self[index] for index in range(len(self)))
