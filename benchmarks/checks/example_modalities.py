"""The modalities whose example captures the campaigns use."""

from __future__ import annotations

from ...captures.layouts import LAYOUTS

__all__ = ["IMAGING", "SMALL"]

#: One of images, in the order of the table of layouts, and one of few values, whose stores are small.
IMAGING, _, SMALL = [*LAYOUTS][:3]
