"""Write the card of a data set: card.md, card.html and its pictures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...captures.contents import contents
from ...captures.store.faces import sharded_place
from ...captures.store.shard_finish import read_request
from ...captures.store.shard_manifest import load_sharded
from ...captures.store.shard_set import ShardedSet, open_sharded
from ...scenes.datasets.spec import Dataset
from ...scenes.errors import InputError
from ...scenes.json_keys import read_json
from ...scenes.validate import validate_spec
from ..folders.files import write_atomic, write_json, write_text
from ..folders.progress import Progress
from ..report.pictures import SEQUENTIAL, png
from .charts import bars, line
from .document import Block, Figure, Figures, Heading, Paragraph, Table, as_html, as_markdown
from .figures import Drawn, GroupFigures, Sample, drawn_of, group_figures
from .leaks import Leaks, check_split

__all__ = ["PICTURES", "Card", "card_of", "write_card"]

#: The folder of the pictures beside card.md.
PICTURES = "pictures"
_UNSTATED = "not stated"


@dataclass
class Card:
    """What the card tells. `leaks` is None where there is no split."""

    data: Dataset
    told: dict[str, Any]
    drawn: list[Drawn]
    groups: list[GroupFigures]
    bases: dict[str, int]
    provenance: dict[str, Any]
    leaks: Leaks | None


def card_of(path: Path, tell: Progress) -> Card:
    """Read a data set for its card: every receipt, and some captures of each modality.

    Raises:
        InputError: the path is no complete data set, or it is damaged.
    """
    place = sharded_place(path)
    if place is None or place[0].name.endswith(".partial"):
        raise InputError(
            "Only a complete data set has a card.", where=str(path), allowed="what `beambench generate DATASET` made",
            next_step="beambench generate DATASET -o DATA",
        )  # fmt: skip
    root = place[0]
    request = read_request(root)
    data = validate_spec(Dataset, request["dataset"], f"{root}: dataset.json")
    sets = [open_sharded(root, name) for name in load_sharded(root).groups]
    table = sets[0].table()
    rows = {name: table.column(name).to_pylist() for name in table.column_names}
    leaks = None if data.split is None else check_split(sets, data.split.by, tell)
    return Card(
        data, contents(root), drawn_of(data, rows), [group_figures(one, tell) for one in sets],
        dict(sorted(Counter(map(str, rows.get("base", []))).items())), _provenance(sets[0]), leaks,
    )  # fmt: skip


def _provenance(captures: ShardedSet) -> dict[str, Any]:
    try:
        found = read_json(str(captures.attributes(0).get("provenance", "")))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def write_card(card: Card, folder: Path, record: dict[str, Any]) -> None:
    """Write card.md, card.html, run.json and the pictures into a folder. Raises InputError."""
    blocks = _blocks(card)
    title = card.data.title or card.data.dataset
    (folder / PICTURES).mkdir(exist_ok=True)
    for block in blocks:
        for one in block.items if isinstance(block, Figures) else ():
            write_atomic(folder / PICTURES / one.file, _writer(one.content))
    write_text(folder / "card.md", as_markdown(blocks, PICTURES))
    write_text(folder / "card.html", as_html(title, blocks))
    write_json(folder / "run.json", record | {"content": card.told["content"]})


def _writer(content: bytes) -> Any:
    return lambda path: path.write_bytes(content)


def _blocks(card: Card) -> list[Block]:
    data = card.data
    found: list[Block] = [Heading(data.title or data.dataset, 1)]
    found += [Paragraph(data.description)] if data.description else []
    found += [
        _facts(card),
        *_contents(card),
        *_made(card),
        *_drawn(card),
        *_measured(card),
        *_samples(card),
        *_split(card),
    ]
    return found


def _facts(card: Card) -> Table:
    data, told = card.data, card.told
    rows = [
        ("name", f"{data.dataset}, version {data.version}"), ("licence", data.licence or _UNSTATED),
        ("citation", data.citation or _UNSTATED), ("captures", f"{told['count']:,}"), ("size", f"{told['bytes'] / 1e6:,.1f} MB"),
        ("content", told["content"]),
    ]  # fmt: skip
    return Table(("what", "value"), rows)


def _contents(card: Card) -> list[Block]:
    groups = [
        (g["group"], f"{g['captures']:,}", " × ".join(f"{n} {d}" for d, n in f.sizes.items()), str(g["shards"]))
        for g, f in zip(card.told["groups"], card.groups, strict=True)
    ]
    parts = [(name or "no split", f"{count:,}") for name, count in card.told["parts"].items()]
    bases = [(name, f"{count:,}") for name, count in card.bases.items()]
    return [
        Heading("Contents"), Table(("modality", "captures", "a capture", "shards"), groups), Table(("part", "captures"), parts),
        Table(("base scene", "captures"), bases),
    ]  # fmt: skip


def _table(made: Mapping[str, Any], name: str) -> dict[str, Any]:
    """A table of the provenance, {} where there is none."""
    found = made.get(name)
    return found if isinstance(found, dict) else {}


def _made(card: Card) -> list[Block]:
    data, made = card.data, card.provenance
    packages = _table(made, "packages")
    versions = ", ".join(f"{name} {version}" for name, version in packages.items())
    cpu = _table(made, "cpu")
    rows = [
        ("made by", f"beambench {made.get('beambench', _UNSTATED)}, Python {made.get('python', _UNSTATED)}"),
        ("packages", versions or _UNSTATED), ("processor", str(cpu.get("model", _UNSTATED))),
        ("model", f"fidelity {data.fidelity}, rtol {data.rtol}"), ("seed", str(data.seed)),
        ("again", "dataset.json in the store is what was asked for; `beambench data verify` compares every byte"),
    ]  # fmt: skip
    return [Heading("Provenance"), Paragraph("As the first capture records it."), Table(("what", "value"), rows)]


def _drawn(card: Card) -> list[Block]:
    if not card.drawn:
        return []
    figures = [
        Figure(
            f"drawn-{one.name}.svg",
            bars(one.name, one.edges, one.found, one.asked, one.labels, log=one.log).encode(),
            f"{one.name} ({one.kind}): columns as drawn" + (", line as asked" if one.asked.size else "")
            + (", logarithmic" if one.log else ""),
        )
        for one in card.drawn
    ]  # fmt: skip
    rows = [
        (
            one.name,
            f"{one.distance:.3f}",
            f"{one.limit:.3f}",
            "as asked" if one.distance <= one.limit else "not as asked",
        )
        for one in card.drawn
        if math.isfinite(one.distance)
    ]
    table: list[Block] = [Table(("parameter", "distance", "limit", "drawn"), rows)] if rows else []
    told = "Distance of Kolmogorov and Smirnov between what was drawn and what was asked; one of 100 sound ones exceeds the limit."
    return [Heading("What was drawn"), Figures(figures), *([Paragraph(told), *table] if rows else [])]


def _measured(card: Card) -> list[Block]:
    rows = [
        (
            f.name, f.measured, f"{f.read:,} of {f.count:,}", f"{f.low:g} … {f.high:g} {f.unit}", f"{f.mean:.4g} {f.unit}",
            f"{100 * f.saturated:.3g} %" if math.isfinite(f.saturated) else "not known",
        )
        for f in card.groups
    ]  # fmt: skip
    figures = [
        Figure(
            f"{f.name}-{f.quantity}.svg", bars(f"{f.quantity}, {f.quantity_unit}", f.edges, f.found, np.empty(0)).encode(),
            f"{f.name}: truth of {f.quantity} [{f.quantity_unit}] over the captures read",
        )
        for f in card.groups
        if f.found.size
    ]  # fmt: skip
    head = ("modality", "variable", "captures read", "range", "mean", "at the converter's top")
    return [Heading("What was measured"), Table(head, rows), *([Figures(figures)] if figures else [])]


def _samples(card: Card) -> list[Block]:
    figures = [_sample(f.name, number, one) for f in card.groups for number, one in enumerate(f.samples)]
    told = "The first capture read of each part and base scene: of the measured variable the plane with most light, and its truth."
    return [Heading("Samples"), Paragraph(told), Figures(figures)]


def _sample(group: str, number: int, one: Sample) -> Figure:
    finite = one.values[np.isfinite(one.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    part = f", {one.part}" if one.part else ""
    caption = f"capture {one.capture}, {one.base}{part}: {one.title}, {low:.4g} … {high:.4g} {one.unit}"
    if min(one.values.shape) < 5:
        # Of several long records, as those of a photodetector, the first: in one line they would look like one.
        values = one.values[0] if one.values.shape[1] > 24 else one.values.reshape(-1)
        return Figure(f"{group}-{number:02d}.svg", line(one.title, values).encode(), caption)
    image = png(one.values, low, high if high > low else low + 1.0, SEQUENTIAL)
    return Figure(f"{group}-{number:02d}.png", image, caption, pixelated=True)


def _split(card: Card) -> list[Block]:
    leaks = card.leaks
    if leaks is None:
        return [Heading("Split"), Paragraph("The data set has no split.")]
    verdict = (
        f"{len(leaks.shared)} scenes are in two parts: the split leaks."
        if leaks.shared
        else f"No scene is in two parts: {leaks.scenes:,} different scenes of {leaks.captures:,} captures."
    )
    told = f"Hashes of {', '.join(leaks.by)} were computed again from the scene that each capture records."
    told += f" {leaks.unlike:,} differ from the recorded ones." if leaks.unlike else " All equal the recorded ones."
    told += (
        f" {leaks.unread:,} scenes name a file that is not here; their recorded hash was taken." if leaks.unread else ""
    )
    found: list[Block] = [Heading("Split"), Paragraph(verdict, strong=True), Paragraph(told)]
    if leaks.near:
        rows = [
            (
                n.part, f"{n.count:,}", _share(n.least), _share(n.median),
                "; ".join(f"{a} to {b}: {_share(d)}" for d, a, b in n.pairs),
            )
            for n in leaks.near
        ]  # fmt: skip
        own = (
            f" Within train the nearest other scene is {_share(leaks.own)} away in the median."
            if leaks.own == leaks.own
            else ""
        )
        found += [
            Paragraph(
                "Nearest scenes of train: the greatest difference of any number of target or medium, as a share of its range over "
                "the data set. Only scenes that differ in numbers alone, but seeds, are compared: a hash does not see that two "
                "differ by a thousandth." + own
            ),
            Table(("part", "scenes", "nearest", "median", "nearest captures"), rows),
        ]  # fmt: skip
    return found


def _share(value: float) -> str:
    if not math.isfinite(value):
        return "–"
    return f"{100 * value:.2g} %" if value < 0.995 else f"{100 * value:.0f} %"
