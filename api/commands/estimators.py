"""The commands `estimators list`, `estimators check`, `estimators new` and `estimators train`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table
from .build import Arguments, View, command

if TYPE_CHECKING:
    from ..benchmarks.laws.suite import LawResult

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


def _broken(results: list[LawResult]) -> list[LawResult]:
    return [result for result in results if not result.holds]


def _check_json(results: list[LawResult], given: Arguments) -> dict[str, Any]:
    from dataclasses import asdict

    return {"ok": not _broken(results), "laws": [asdict(result) for result in results]}


def _check_text(results: list[LawResult], given: Arguments) -> None:
    print_table(
        ("law", "", "seen"), [(r.law, "ok" if r.holds else "BROKEN", "" if r.holds else r.seen) for r in results]
    )
    broken = len(_broken(results))
    print_lines("", f"{broken} of {len(results)} laws are broken" if broken else f"all {len(results)} laws hold")


CHECK = command(
    "estimators check",
    "estimators:estimators_check",
    View(_check_text, _check_json, lambda results: int(bool(_broken(results)))),
    examples="Example:\n  beambench estimators check poisson-ml",
)


def _new_json(folder: Path, given: Arguments) -> dict[str, Any]:
    return {"out": str(folder)}


def _new_text(folder: Path, given: Arguments) -> None:
    name = given["name"]
    print_lines(f"package  {folder}", f"next     pip install -e {folder} && beambench estimators check {name}")


NEW = command(
    "estimators new",
    "estimators:estimators_new",
    View(_new_text, _new_json),
    examples="Example:\n  beambench estimators new my-median -o my-median",
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
