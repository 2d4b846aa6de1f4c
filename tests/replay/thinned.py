"""Flights of which the default tests fly some: the others are flown with the live tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
from _pytest.mark.structures import ParameterSet


def thinned(values: Sequence[tuple[Any, ...]], *, each: int, ids: Sequence[str] | None = None) -> list[ParameterSet]:
    """Return parameters of a test, all but each so manieth marked as live."""
    return [
        pytest.param(
            *value, marks=() if place % each == 0 else pytest.mark.live, id=ids[place] if ids is not None else None
        )
        for place, value in enumerate(values)
    ]
