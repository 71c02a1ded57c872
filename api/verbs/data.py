"""`beambench data status|verify|repair|finalize`: the state of a store of captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..captures.store.recovery import Recovery
    from ..captures.store.verification import Damage

__all__ = ["data_finalize", "data_repair", "data_status", "data_verify"]


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


def data_verify(data: str | Path) -> list[Damage]:
    """Read every byte of a store and list the damage; the exit code is 1 if there is any.

    Main arguments:
        data: The store.

    Returns:
        The damaged files; none if the store is sound.

    Raises:
        InputError: There is no store with an undamaged manifest.
    """
    from ..captures import verify

    return verify(data)


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
