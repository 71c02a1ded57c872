"""What a file of another program holds: arrays by name, and facts of its header. Sizes are bounded before memory is taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ...scenes.errors import InputError

__all__ = ["MOST_BYTES", "Array", "Recording", "check_bytes", "reading"]

Array = npt.NDArray[Any]
Result = TypeVar("Result")

#: Most bytes of the arrays of a file.
MOST_BYTES = 2**30


@dataclass(frozen=True, eq=False)
class Recording:
    """The content of a file.

    Main arguments:
        arrays: by name; the first one is the main one.
        axes: names of the axes of the main array, as far as the format tells them.
    Other arguments:
        header: facts that the file states: numbers and texts.
        units: of arrays whose unit the format states.
    """

    arrays: Mapping[str, Array]
    axes: tuple[str, ...] = ()
    header: Mapping[str, float | int | str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def array(self, name: str, where: str) -> Array:
        """The array of a name; the main one for "". Raises InputError where there is none."""
        if not name:
            return next(iter(self.arrays.values()))
        if name not in self.arrays:
            raise InputError(
                "The file has no array of this name.", where=where, value=name, allowed=", ".join(self.arrays)
            )
        return self.arrays[name]


def check_bytes(shape: Sequence[int], item: int, what: str = "it") -> None:
    """Raise ValueError for sizes that are negative, or of more than `MOST_BYTES` in all."""
    if any(size < 0 for size in shape) or math.prod(int(size) for size in shape) * item > MOST_BYTES:
        raise ValueError(f"{what} has the shape {tuple(shape)}: more than {MOST_BYTES:,} bytes, or less than none")


def reading(read: Callable[[Path], Result], path: Path, what: str) -> Result:
    """`read(path)`, whose errors become one InputError: libraries raise a dozen kinds on a damaged file.

    Raises:
        InputError: absent, damaged, or too large.
    """
    if not path.is_file():
        raise InputError("There is no such file.", where=str(path), allowed=f"a {what} file")
    try:
        with np.errstate(all="ignore"):
            return read(path)
    except InputError:
        raise
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # a damaged file may raise anything, a library's own panic too
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"The {what} file cannot be read.", where=str(path), value=said, allowed=f"a whole {what} file",
            next_step="copy it again from the instrument, and compare the sizes of both files",
        ) from error  # fmt: skip
