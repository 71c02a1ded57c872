"""`beambench data status|verify|repair|finalize`: the state of a store of captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..benchmarks.folders.progress import Progress
    from ..captures.store.recovery import Recovery
    from ..captures.store.verification import Damage

__all__ = ["data_card", "data_finalize", "data_repair", "data_status", "data_verify"]


def data_status(data: str | Path) -> dict[str, Any]:
    """Show the contents of a store of captures, or how far a data set is; the exit code is 1 for one that has lost captures.

    Main arguments:
        data: The store.

    Returns:
        Modality, number of captures, sizes, bytes on disk, and of each capture its scene, seed, kind of truth and rung. Of a data
        set its state, groups, shards and parts, and what is missing, dropped or damaged.

    Raises:
        InputError: There is no store with undamaged metadata.
    """
    from ..captures.contents import contents

    return contents(Path(data))


def data_card(
    data: str | Path, *, out: str | Path | None = None, overwrite: bool = False, progress: Progress | None = None
) -> Path:
    """Write the card of a data set: licence, provenance, figures, sample pictures, and whether its split leaks.

    card.md and its pictures are for a repository, card.html is one page without network. Licence, title, description and citation
    are those of the data set's file; what is not stated there is called so.

    Main arguments:
        data: The data set.
    Other arguments:
        out: Folder of the card; ./beambench-runs/card-<name>-<time> by default. It lies outside of the data set.
        overwrite: Replace an earlier card in `out`.
        progress: Receives every step.

    Returns:
        The folder.

    Raises:
        InputError: No complete data set, a damaged one, or an output that exists.
    """
    from ..benchmarks.card.card import card_of, write_card
    from ..benchmarks.folders.kinds import CARD, slug
    from ..benchmarks.folders.progress import silent
    from ..benchmarks.folders.workplace import output_folder, workplace
    from ..captures.store.faces import sharded_place

    source = Path(data).expanduser()
    place = sharded_place(source)
    folder = output_folder(out, f"card-{slug(source.stem)}", resume=False, overwrite=overwrite)
    with workplace(folder, CARD, overwrite=overwrite, inputs=[source] if place is None else [source, place[0]]) as work:
        write_card(card_of(source, progress or silent), work, {"verb": CARD.verb, "data": source.name})
    return folder


def data_verify(data: str | Path) -> list[Damage]:
    """Read every byte of a store and list the damage; the exit code is 1 if there is any.

    Main arguments:
        data: The store; of one group of a data set the whole data set is read.

    Returns:
        The damaged files; none if the store is sound.

    Raises:
        InputError: There is no store with an undamaged manifest.
    """
    from ..captures import verify
    from ..captures.store.shard_manifest import is_sharded

    # A group of a data set is a store for its readers; what is listed of it stands in the data set's manifest.
    whole = Path(data).absolute().parent
    return verify(whole if is_sharded(whole) and not is_sharded(Path(data)) else data)


def data_repair(data: str | Path, *, overwrite: bool = False, regenerate: bool = False) -> Recovery:
    """Write damaged metadata of a store again, and remove its damaged captures; the removed files stay beside it in NAME.dropped.

    A data set still knows how its removed captures were made: a later repair with `regenerate`, or `beambench generate … --resume`,
    brings them back.

    Main arguments:
        data: The store, or an unfinished one (NAME.partial).
    Other arguments:
        overwrite: Replace an existing output.
        regenerate: Make damaged captures again from the scene and the arguments that they record. What is made must have the
            checksums of what was written; else the capture is removed.

    Raises:
        InputError: There is no store, a file cannot be read, both sets of metadata are damaged, or no capture is sound.
    """
    from ..captures import repair

    if not regenerate:
        return repair(data, overwrite=overwrite)
    from ..benchmarks.datasets.generate import maker_of

    return repair(data, overwrite=overwrite, make=maker_of(Path(data).expanduser()))


def data_finalize(data: str | Path, *, overwrite: bool = False) -> Recovery:
    """Turn the complete captures of an interrupted `beambench generate` into a store.

    Main arguments:
        data: Name of the store, with or without .partial.
    Other arguments:
        overwrite: Replace an existing store.

    Raises:
        InputError: There is no unfinished store, or it is damaged.
    """
    from ..captures import finalize

    return finalize(data, overwrite=overwrite)
