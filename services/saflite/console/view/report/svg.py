"""Small helpers to write SVG: elements, polylines, number texts."""

from __future__ import annotations

import math
from collections.abc import Iterable

from saflite.console.view.html_text import escape

Point = tuple[float, float]


def tag(name: str, content: str = "", **attributes: object) -> str:
    """Return one element; `_` in attribute names stands for `-`, a trailing one is dropped."""
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(_text(value))}"' for key, value in attributes.items()
    )
    return f"<{name}{written}>{content}</{name}>" if content else f"<{name}{written}/>"


def label(x: float, y: float, text: str, css: str = "", anchor: str = "start") -> str:
    """Return a text at a place."""
    return tag("text", escape(text), x=x, y=y, class_=css, text_anchor=anchor)


def points(places: Iterable[Point]) -> str:
    """Return places as the `points` of a polyline."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)


def _text(value: object) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)


def nice_step(span: float, wanted: int) -> float:
    """Return a step of 1, 2 or 5 times a power of ten that cuts `span` into about `wanted` parts."""
    if span <= 0:
        return 1.0
    raw = span / max(1, wanted)
    power = 10.0 ** math.floor(math.log10(raw))
    return next((factor * power for factor in (1, 2, 5) if factor * power >= raw), 10 * power)
