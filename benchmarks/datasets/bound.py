"""The bounds of the captures of a store, a row for each capture and quantity."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...scenes.errors import InputError
from .score import scene_name

__all__ = ["bound_rows"]


def bound_rows(data: Path) -> list[dict[str, Any]]:
    """One row per capture and quantity: kind of the bound, its median and rms over elements, prior, scale and window.

    An element without a truth does not count; one without information has no part in the median and rms, and its number
    is elements − informed. rms: √mean(min(b, prior)²).

    Raises:
        InputError: No store, no truth, or a modality that is not scored.
    """
    from ...captures import open_captures
    from ...captures.layouts import layout_of
    from ..judges import judge_of
    from ..judges.bound import bounds_of, truths_of

    captures = open_captures(data)
    judge_of(captures.modality)  # refuses a modality that is not scored, before anything is read
    unit = {q.name: q.unit for stage in layout_of(captures.modality).stages for q in stage.gives}
    rows: list[dict[str, Any]] = []
    for index in range(len(captures)):
        capture = captures[index]
        if capture.attrs.get("truth_kind") == "none":
            raise InputError(
                "The capture holds no truth to bound an estimate of.", where=f"{data}, capture {index}", value="none",
                next_step="add the truth, e.g. surveyed ranges, when the capture is made",
            )  # fmt: skip
        truths = truths_of(capture)
        for quantity, found in bounds_of(capture).items():
            least = found.sigma[np.isfinite(truths[quantity].value)]
            finite = np.minimum(least[np.isfinite(least)], found.prior)
            known = finite.size > 0
            rows.append(
                {
                    "capture": index, "scene": scene_name(capture.attrs, index),
                    "quantity": quantity, "unit": unit[quantity], "kind": found.kind, "elements": int(least.size),
                    "informed": int(finite.size), "bound_median": float(np.median(finite)) if known else float("nan"),
                    "bound_rms": float(np.sqrt(np.mean(finite**2))) if known else float("nan"),
                    "prior": found.prior, "scale": found.scale, "window": found.window,
                }
            )  # fmt: skip
    return rows
