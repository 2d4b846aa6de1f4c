"""The faults written by hand still fit the lines they are planted in."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts" / "benches"))
from _authored_faults import authored
from _blind_faults import planted


@pytest.mark.parametrize("name", list(authored()))
def test_each_finds_its_line(name: str) -> None:
    with planted((authored()[name],)):
        pass
