"""Planted defects: known faults of real autopilots, each one switch, off by default."""

from __future__ import annotations

from collections.abc import Iterable


def unchecked_parameters(defects: Iterable[str]) -> frozenset[str]:
    """Return the parameters whose range is not checked while these defects are on."""
    return frozenset()


def check_defects(defects: Iterable[str]) -> None:
    """Raise Refused for a defect that does not exist."""
