"""The software noted in a run folder, compared with the software at hand."""

from __future__ import annotations

from pathlib import Path

import msgspec

from saflite.console.run_data import provenance
from saflite.flight.autopilots.described import default_target


def test_another_build_is_named_and_the_same_is_not(tmp_path: Path) -> None:
    target = default_target()
    provenance.note(tmp_path, target)
    assert provenance.differs(tmp_path) == ""
    provenance.note(tmp_path, msgspec.structs.replace(target, build="0" * 64))
    assert provenance.differs(tmp_path) == f"build {'0' * 12} then, {target.build[:12]} now"


def test_what_is_not_known_is_no_difference(tmp_path: Path) -> None:
    assert provenance.differs(tmp_path) == ""
    provenance.note(tmp_path, msgspec.structs.replace(default_target(), name="gone"))
    assert provenance.differs(tmp_path) == ""
