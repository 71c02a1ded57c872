"""FITS (Pence et al. 2010, A&A 524:A42): every image of the file, scaled as its header says. Needs astropy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .recording import Array, Recording, check_bytes

__all__ = ["read_fits"]

#: Facts that are kept of a header, of at most this many cards.
_MOST_CARDS = 2000


def read_fits(path: Path) -> Recording:
    """Images by the number of their unit ("0", "1", …); the main one is the last. Axes (row, col), or (page, row, col).

    Raises InputError without astropy, ValueError and what astropy raises for a file that is none.
    """
    try:
        from astropy.io import fits
    except ImportError as error:
        raise InputError(
            "Reading FITS needs astropy.", where=str(path), next_step='pip install "beambench[imports]"'
        ) from error
    import warnings

    images: dict[str, Array] = {}
    header: dict[str, float | int | str] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with fits.open(path, ignore_missing_simple=True, memmap=False, lazy_load_hdus=False) as units:
            for number, unit in enumerate(units):
                if not isinstance(unit, fits.PrimaryHDU | fits.ImageHDU) or not unit.shape:
                    continue
                check_bytes(unit.shape, 8, f"image {number}")
                values = np.asarray(unit.data)
                images[str(number)] = values.astype(values.dtype.newbyteorder("="))
                header |= _facts(unit.header)
    if not images:
        raise ValueError("it holds no image")
    main = list(images)[-1]
    ordered = {main: images.pop(main), **images}
    axes = ("page", "row", "col")[-ordered[main].ndim :] if ordered[main].ndim <= 3 else ()
    return Recording(ordered, axes, header)


def _facts(cards: Any) -> dict[str, float | int | str]:
    return {
        str(name): value
        for name, value in list(cards.items())[:_MOST_CARDS]
        if isinstance(value, int | float | str) and name not in ("", "COMMENT", "HISTORY")
    }
