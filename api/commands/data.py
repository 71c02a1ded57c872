"""The commands `data card`, `data status`, `data verify`, `data repair` and `data finalize`."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING, Any

from ..console import print_lines, print_table, size_text
from .build import Arguments, View, command

if TYPE_CHECKING:
    from pathlib import Path

    from ..captures.store.recovery import Recovery
    from ..captures.store.verification import Damage

__all__ = ["CARD", "FINALIZE", "REPAIR", "STATUS", "VERIFY"]


def _status_json(status: dict[str, Any], given: Arguments) -> dict[str, Any]:
    return status


def _status_text(status: dict[str, Any], given: Arguments) -> None:
    if "groups" in status:
        _data_set(status)
        return
    sizes = " × ".join(f"{size} {name}" for name, size in status["sizes"].items())
    print_lines(
        f"{status['path']}: {status['count']} {status['modality']} captures, {sizes}, {size_text(status['bytes'])}"
    )
    columns = ("capture", "scene", "seed", "truth", "fidelity")
    rows = [[str(row[name]) if row[name] is not None else "–" for name in columns] for row in status["captures"]]
    print_table(columns, rows, right=("capture", "seed"))


def _data_set(status: dict[str, Any]) -> None:
    print_lines(
        f"{status['path']}: data set {status['dataset']}, {status['state']}, {status['count']} of {status['asked']} captures, "
        f"{size_text(status['bytes'])}"
    )
    numbers = ("captures", "shards", "a shard")
    rows = [
        (g["group"], " × ".join(f"{n} {name}" for name, n in g["sizes"].items()), str(g["captures"]),
         f"{g['shards']} of {g['shards_asked']}" if g["shards_asked"] else str(g["shards"]), str(g["captures_per_shard"]))
        for g in status["groups"]
    ]  # fmt: skip
    print_table(("group", "sizes", *numbers), rows, right=numbers)
    print_lines(*(f"{name or 'no split'}: {count} captures" for name, count in status["parts"].items()))
    print_lines(*([f"content {status['content']}"] if status["finished"] else []))
    if status["missing"] and status["finished"]:
        print_lines(f"missing {status['missing']} captures")
    print_lines(
        *([f"dropped {_few(status['dropped'])}"] if status["dropped"] else []),
        *([f"damaged {_few(status['damaged'])}"] if status["damaged"] else []),
        *_next(status),
    )


def _few(names: list[Any]) -> str:
    more = f", and {len(names) - 8} more" if len(names) > 8 else ""
    return ", ".join(map(str, names[:8])) + more


def _next(status: dict[str, Any]) -> list[str]:
    if status["state"] == "complete":
        return []
    resume = "the same beambench generate with --resume"
    if status["finished"] and (status["damaged"] or status["dropped"]):
        return [f"next    beambench data repair {quote(str(status['path']))} --regenerate, then {resume}"]
    return [f"next    {resume}"]


def _status_code(status: dict[str, Any]) -> int:
    """1 for a data set that has lost captures; one that is being made has lost none."""
    return int(status.get("state", "complete") in ("incomplete", "damaged"))


def _card_json(folder: Path, given: Arguments) -> dict[str, Any]:
    return {
        "out": str(folder),
        "files": sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()),
    }


def _card_text(folder: Path, given: Arguments) -> None:
    print_lines(f"card     {folder}/card.md", f"page     {folder}/card.html")


CARD = command(
    "data card",
    "data:data_card",
    View(_card_text, _card_json),
    examples="Example:\n  beambench data card gated-1k -o gated-1k-card",
)
STATUS = command(
    "data status",
    "data:data_status",
    View(_status_text, _status_json, _status_code),
    examples="Example:\n  beambench data status captures.zarr",
)


def _verify_json(damage: list[Damage], given: Arguments) -> dict[str, Any]:
    from dataclasses import asdict

    return {"sound": not damage, "damage": [asdict(item) for item in damage]}


def _verify_text(damage: list[Damage], given: Arguments) -> None:
    if damage:
        print_lines(*(str(item) for item in damage), _advice(given["data"], damage))
    else:
        print_lines(f"{given['data']}: sound")


def _advice(data: str, damage: list[Damage]) -> str:
    """How many files are wrong, and what helps: a repair only where `data repair` would do one."""
    from pathlib import Path

    from ..captures.store.manifest import ASK_FOR_RIGHTS, RECORD, TAKE_ANEW
    from ..captures.store.verification import FOREIGN

    unreadable = sum(item.unreadable for item in damage)
    if unreadable:
        return f"{unreadable} files cannot be read; next: {ASK_FOR_RIGHTS}"
    foreign = sum(item.problem == FOREIGN for item in damage)
    if foreign == len(damage):
        return f"{foreign} files are not of the store; next: move them away"
    metadata = any(item.capture is None and item.file.endswith("zarr.json") for item in damage)
    beyond = metadata and not Path(data).expanduser().joinpath(RECORD).is_file()
    return f"{len(damage)} files are damaged; next: " + (TAKE_ANEW if beyond else f"beambench data repair {data}")


VERIFY = command(
    "data verify",
    "data:data_verify",
    View(_verify_text, _verify_json, lambda damage: int(bool(damage))),
    examples="Example:\n  beambench data verify captures.zarr",
)


def _recovery_json(recovery: Recovery, given: Arguments) -> dict[str, Any]:
    return {
        "path": str(recovery.path),
        "kept": recovery.kept,
        "dropped": list(recovery.dropped),
        "damage": [str(item) for item in recovery.damage],
        "aside": None if recovery.aside is None else str(recovery.aside),
        "restored": list(recovery.restored),
        "remade": list(recovery.remade),
        "not_remade": list(recovery.not_remade),
    }


def _recovery_text(recovery: Recovery, given: Arguments) -> None:
    dropped = f", dropped {', '.join(map(str, recovery.dropped))}" if recovery.dropped else ""
    print_lines(f"{recovery.path}: {recovery.kept} captures{dropped}")
    if recovery.restored:
        print_lines(f"written again: {', '.join(recovery.restored)}")
    if recovery.remade:
        print_lines(f"made again: captures {', '.join(map(str, recovery.remade))}")
    print_lines(*(f"not made again: {reason}" for reason in recovery.not_remade))
    if recovery.aside is not None:
        print_lines(f"{recovery.aside}: the files of the dropped captures")


REPAIR = command(
    "data repair",
    "data:data_repair",
    View(_recovery_text, _recovery_json),
    examples="Examples:\n  beambench data repair captures.zarr\n  beambench data repair captures.zarr --regenerate",
)
FINALIZE = command(
    "data finalize",
    "data:data_finalize",
    View(_recovery_text, _recovery_json),
    examples="Example:\n  beambench data finalize captures.zarr",
)
