"""Small charts as SVG: histograms of what was drawn beside what was asked, and lines. Text in them is escaped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

__all__ = ["bars", "line"]

Array = np.ndarray[Any, Any]
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 440, 190, 66, 12, 26, 36
_FOUND, _ASKED = "#0072B2", "#D55E00"


def bars(title: str, edges: Array, found: Array, asked: Array, labels: Sequence[str] = (), *, log: bool = False) -> str:
    """A histogram: columns are what was found, the line is what was asked. With `labels` one column a value."""
    count = len(found)
    places = np.linspace(0.0, 1.0, count + 1) if labels or log else (edges - edges[0]) / (edges[-1] - edges[0])
    most = float(max(found.max(initial=0), asked.max(initial=0))) or 1.0
    width, height = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    x = _LEFT + places * width
    y = _TOP + height * (1 - found / most)
    parts = [
        f'<rect x="{x[n] + 0.5:.1f}" y="{y[n]:.1f}" width="{max(x[n + 1] - x[n] - 1, 0.5):.1f}" '
        f'height="{max(_TOP + height - y[n], 0):.1f}" fill="{_FOUND}"/>'
        for n in range(count)
    ]
    if asked.size:
        heights = _TOP + height * (1 - asked / most)
        path = " ".join(f"{'M' if n == 0 else 'L'}{x[n]:.1f} {heights[n]:.1f}H{x[n + 1]:.1f}" for n in range(count))
        parts.append(f'<path d="{path}" fill="none" stroke="{_ASKED}" stroke-width="2"/>')
    if labels:
        ticks = [
            (0.5 * (x[n] + x[n + 1]), label) for n, label in enumerate(labels) if count <= 8 or n in (0, count - 1)
        ]
    else:
        ticks = [(x[n], _number(float(edges[n]))) for n in (0, count // 2, count)]
    return _framed(title, parts, ticks, [(_TOP, _number(most)), (_TOP + height, "0")])


def line(title: str, values: Array) -> str:
    """Values against their number."""
    height, width = _HEIGHT - _TOP - _BOTTOM, _WIDTH - _LEFT - _RIGHT
    finite = np.isfinite(values)
    low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 1.0)
    span = high - low or max(abs(high), 1.0)
    x = _LEFT + width * np.arange(values.size) / max(values.size - 1, 1)
    y = _TOP + height * (1 - (np.where(finite, values, low) - low) / span)
    drawn = [
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2" fill="{_FOUND}"/>'
        for a, b, ok in zip(x, y, finite, strict=True)
        if ok
    ]
    if values.size > 60:
        path = " ".join(f"{'M' if n == 0 else 'L'}{x[n]:.1f} {y[n]:.1f}" for n in range(values.size))
        drawn = [f'<path d="{path}" fill="none" stroke="{_FOUND}" stroke-width="1.2"/>']
    ends = [(float(x[0]), "0"), (float(x[-1]), str(values.size - 1))] if values.size > 1 else [(float(x[0]), "0")]
    return _framed(title, drawn, ends, [(_TOP, _number(high)), (_TOP + height, _number(low))])


def _framed(
    title: str, parts: Sequence[str], below: Sequence[tuple[float, str]], beside: Sequence[tuple[float, str]]
) -> str:
    base = _HEIGHT - _BOTTOM
    texts = [
        f'<text x="{min(max(x, _LEFT), _WIDTH - _RIGHT):.1f}" y="{base + 16}" text-anchor="'
        f'{"start" if x < _LEFT + 20 else "end" if x > _WIDTH - _RIGHT - 20 else "middle"}">{escape(_short(text))}</text>'
        for x, text in below
    ]
    texts += [f'<text x="{_LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{escape(text)}</text>' for y, text in beside]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}" '
        f'role="img" aria-label="{escape(title)}" font-family="sans-serif" font-size="11">'
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#ffffff"/><text x="{_LEFT}" y="16" font-size="12" font-weight="bold">'
        f"{escape(title)}</text>{''.join(parts)}"
        f'<path d="M{_LEFT} {_TOP}V{base}H{_WIDTH - _RIGHT}" fill="none" stroke="#475569"/>{"".join(texts)}</svg>'
    )


def _short(text: str) -> str:
    return text if len(text) <= 24 else text[:23] + "…"


def _number(value: float) -> str:
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "–"
    return f"{value:.3g}"
