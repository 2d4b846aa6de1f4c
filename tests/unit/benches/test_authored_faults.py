"""The faults written by hand still fit the lines they are planted in."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts" / "benches"))
from _authored_faults import authored
from _blind_faults import planted
from _rule_faults import rule_faults

PATCHES = {**authored(), **{f"rules/{name}": fault.patch for name, fault in rule_faults().items()}}


@pytest.mark.parametrize("name", list(PATCHES))
def test_each_finds_its_line(name: str) -> None:
    with planted((PATCHES[name],)):
        pass
