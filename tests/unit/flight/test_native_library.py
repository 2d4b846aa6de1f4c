"""The compiled library says what it was built from: flying on stale code is refused, not done silently."""

from __future__ import annotations

import ctypes
from pathlib import Path

import pytest

from saflite.contract.errors import Unavailable
from saflite.flight import native_library as library
from saflite.flight import native_sources


def test_the_library_was_built_from_the_sources_beside_it() -> None:
    assert library.built_from(ctypes.CDLL(str(library.LIBRARY))) == native_sources.digest()
    assert len(native_sources.sources("c")) > 10


def test_a_library_of_other_sources_is_refused_with_the_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "digest", lambda: "of sources changed since")
    for load in (library.native_library, library.python_library):
        with pytest.raises(Unavailable, match=r"other sources.*build_native"):
            load.__wrapped__()


def test_a_missing_library_is_refused_with_the_fix(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(library, "LIBRARY", tmp_path / "none.so")
    with pytest.raises(Unavailable, match="build_native"):
        library.native_library.__wrapped__()
