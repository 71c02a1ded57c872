"""Write the file of a new scene or suite."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

__all__ = ["write_new"]


def write_new(
    name: str,
    kind: str,
    key: str,
    library: Path,
    names: Sequence[str],
    like: str,
    out: str | Path | None,
    overwrite: bool,
    head: str,
) -> Path:
    """Write `library`/`like`.toml under the name `name` to `out`, ./`name`.toml by default.

    Main arguments:
        name, like: of the new file and of the one that it begins from. kind: "scene" or "suite". key: what holds its name.
        library, names: the folder of those that ship, and their names. head: comment on top; {file} is the path.

    Raises:
        InputError: a bad name, an unknown `like`, a name that does not end in .toml, or a file that exists.
    """
    from ..benchmarks.folders.files import write_atomic
    from ..output import check_free
    from ..scenes.errors import InputError
    from ..scenes.nearest import did_you_mean
    from ..scenes.new_files import begun_from, check_spec_name
    from ..scenes.places import local_path

    check_spec_name(name, kind)
    if like not in names:
        raise InputError(
            f"There is no such {kind} to begin from.", where="like", value=like, allowed=", ".join(names),
            next_step=did_you_mean(like, names, f"beambench {kind}s list", cutoff=0.4),
        )  # fmt: skip
    path = local_path(out if out is not None else f"{name}.toml")
    if path.suffix.lower() != ".toml":
        raise InputError(f"The file of a {kind} ends in .toml.", where="out", value=str(out), allowed="*.toml")
    check_free(path, overwrite=overwrite)
    text = begun_from(library / f"{like}.toml", key, name, head.format(file=path.name))
    path.parent.mkdir(parents=True, exist_ok=True)

    def write(partial: Path) -> None:
        partial.write_text(text, encoding="utf-8")

    write_atomic(path, write)
    return path
