"""The commands `estimators list`, `estimators check`, `estimators new` and `estimators train`."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..benchmarks.laws.check import Check
    from ..benchmarks.laws.place import Place

__all__ = ["CHECK", "LIST", "NEW", "TRAIN"]


def _list_json(rows: list[dict[str, Any]], given: Arguments) -> list[dict[str, Any]]:
    return rows


def _list_text(rows: list[dict[str, Any]], given: Arguments) -> None:
    print_table(
        ("estimator", "modality", "parameters", "source", "from"),
        [
            (
                r["name"],
                r["modality"],
                ", ".join(f"{k}={v}" for k, v in r["parameters"].items()) or "–",
                r["error"] or r["cites"],
                r["origin"],
            )
            for r in rows
        ],
    )


LIST = command(
    "estimators list",
    "estimators:estimators_list",
    View(_list_text, _list_json),
    examples="Example:\n  beambench estimators list",
)


def _check_json(found: Check, given: Arguments) -> dict[str, Any]:
    from dataclasses import asdict

    laws = [asdict(result) for result in found.laws]
    return {"ok": found.ok, "laws": laws, "place": None if found.place is None else asdict(found.place)}


def _check_text(found: Check, given: Arguments) -> None:
    print_table(
        ("law", "", "seen"), [(r.law, "ok" if r.holds else "BROKEN", "" if r.holds else r.seen) for r in found.laws]
    )
    broken = sum(not result.holds for result in found.laws)
    print_lines("", f"{broken} of {len(found.laws)} laws are broken" if broken else f"all {len(found.laws)} laws hold")
    if found.place is not None:
        _place_text(found.place)
        if given.get("chart") and not found.place.why:
            print_lines("", f"chart    {given['chart']}")


def _place_text(place: Place) -> None:
    from ..benchmarks.report.place_chart import text_chart

    if place.why:
        print_lines("", f"no comparison: {place.why}")
        return
    bound = f"; bound {place.bound:.3g} {place.unit}" if place.bound > 0 else ""
    print_lines(
        "",
        f"{place.quantity}, {place.elements} elements of {place.captures} clean capture{'s' if place.captures > 1 else ''}{bound}",
    )
    print_table(
        ("", "estimator", f"rms error [{place.unit}]", "answered", "error/sigma", "CPU per element [us]", "status"),
        [
            (
                "*" if one.own else "", one.label, f"{one.rmse:.3g}", f"{one.coverage:.0%}", f"{one.z_rms:.2f}",
                f"{1e6 * one.cpu_s:.3g}", one.status,
            )
            if one.status == "ok"
            else ("*" if one.own else "", one.label, "–", "–", "–", "–", one.status)
            for one in sorted(place.standings, key=lambda one: (one.status != "ok", one.rmse))
        ],
        right=(f"rms error [{place.unit}]", "answered", "error/sigma", "CPU per element [us]"),
    )  # fmt: skip
    print_lines("", *text_chart(place), "")
    for one in place.breakdowns:
        beside = f"; {one.best}: {_level(one.best_first)}" if one.best and one.best != place.own.label else ""
        print_lines(f"a tenth of the answers fails at {one.stress}: {_level(one.first)}{beside}")


def _level(level: float | None) -> str:
    if level == 1.0:
        return "already that of the clean capture"
    return "none of the levels tried" if level is None else f"{level:g} times that of the clean capture"


CHECK = command(
    "estimators check",
    "estimators:estimators_check",
    View(_check_text, _check_json, lambda found: int(not found.ok)),
    examples="Examples:\n  beambench estimators check poisson-ml\n"
    "  beambench estimators check line-steger --chart line-steger.png\n"
    "  beambench estimators check my-median --no-compare",
)


def _new_json(folder: Path, given: Arguments) -> dict[str, Any]:
    return {"out": str(folder)}


def _new_text(folder: Path, given: Arguments) -> None:
    name = given["name"]
    print_lines(
        f"package  {folder}", f"next     pip install -e {quote(str(folder))} && beambench estimators check {name}"
    )


NEW = command(
    "estimators new",
    "estimators:estimators_new",
    View(_new_text, _new_json),
    examples="Examples:\n  beambench estimators new my-median -o my-median\n"
    "  beambench estimators new my-finder --stage line -o my-finder",
)


def _train_json(trained: dict[str, float], given: Arguments) -> dict[str, Any]:
    return {"out": given["out"], **trained}


def _train_text(trained: dict[str, float], given: Arguments) -> None:
    print_lines(
        f"weights   {given['out']} ({trained['bytes'] / 1e3:.0f} kB)",
        f"trained   on {trained['pixels']:.0f} pixels of {trained['captures']:.0f} captures",
        f"error     {trained['rms_held_out']:.3g} of the response's width on pixels held out of training; "
        f"the first guess has {trained['rms_first_guess']:.3g}",
        f"next      beambench estimate DATA -e 'learned[weights={given['out']}]'",
    )


TRAIN = command(
    "estimators train",
    "estimators:estimators_train",
    View(_train_text, _train_json),
    options=("data",),
    examples="""Example (repeats the weights that ship with Beambench):
  beambench generate learned-training -o training
  beambench estimators train --data training --out weights.npz""",
)
