"""The next step of a message about a name that is not known."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

__all__ = ["did_you_mean"]


def did_you_mean(
    word: str, known: Iterable[str], otherwise: str = "", *, cutoff: float = 0.6, folder: Path | None = None
) -> str:
    """ "did you mean A or B?" with up to three names like `word`; `otherwise` without any.

    Other arguments:
        cutoff: least likeness, 0 to 1 (`difflib.get_close_matches`). folder: in front of each name.
    """
    import difflib

    near = difflib.get_close_matches(word, list(known), n=3, cutoff=cutoff)
    told = near if folder is None else [str(folder / name) for name in near]
    return f"did you mean {' or '.join(told)}?" if told else otherwise
