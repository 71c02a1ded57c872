"""`beambench data status|verify|repair|finalize`: the state of a store of captures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..captures.store.recovery import Recovery
    from ..captures.store.verification import Damage

__all__ = ["data_finalize", "data_repair", "data_status", "data_verify"]


def data_status(data: str | Path) -> dict[str, Any]:
    """What a store holds: modality, number of captures, sizes, and of each capture its scene, seed and kind of truth.

    Raises:
        InputError: there is no store with sound metadata.
    """
    import json

    from ..captures import open_captures

    root = Path(data)
    captures = open_captures(root)
    rows = []
    for index in range(len(captures)):
        attrs = captures.attributes(index)
        scene = json.loads(attrs["truth_scene"]) if isinstance(attrs.get("truth_scene"), str) else {}
        fidelity = json.loads(attrs["fidelity"]) if isinstance(attrs.get("fidelity"), str) else {}
        rows.append(
            {
                "capture": index,
                "scene": (scene or {}).get("name", ""),
                "seed": attrs.get("seed"),
                "truth": attrs.get("truth_kind", ""),
                "fidelity": (fidelity or {}).get("rung", ""),
            }
        )
    sizes = {str(name): int(size) for name, size in captures.load(0).sizes.items()} if rows else {}
    used = sum(file.stat().st_size for file in root.rglob("*") if file.is_file())
    return {
        "path": str(root),
        "modality": captures.modality,
        "count": len(rows),
        "sizes": sizes,
        "bytes": used,
        "captures": rows,
    }


def data_verify(data: str | Path) -> list[Damage]:
    """Read every byte of a store and list what is damaged; an empty list says that it is sound.

    Raises:
        InputError: there is no store with a sound manifest.
    """
    from ..captures import verify

    return verify(data)


def data_repair(data: str | Path, *, overwrite: bool = False) -> Recovery:
    """Drop the damaged captures of a store; the sound ones keep their order, and the files dropped stay in NAME.dropped.

    Raises:
        InputError: nothing there, a file that cannot be read, damaged metadata, or no sound capture.
    """
    from ..captures import repair

    return repair(data, overwrite=overwrite)


def data_finalize(data: str | Path, *, overwrite: bool = False) -> Recovery:
    """Turn the complete captures of an interrupted run (`NAME.partial`) into a store.

    Raises:
        InputError: nothing unfinished there, or damage.
    """
    from ..captures import finalize

    return finalize(data, overwrite=overwrite)
