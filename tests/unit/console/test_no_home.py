"""Commands in a container whose user has neither a home nor a name, or a home that cannot be written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.contract.config import cache_root
from saflite.flight.autopilots.external import listing
from saflite.flight.autopilots.external.listing import Listing, Row

FOUND = Listing(binary=64 * "a", parameters={"A": Row(1.0, 9)})


@pytest.fixture
def nobody(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("HOME", "SAFLITE_CACHE", "XDG_CACHE_HOME", "XDG_DATA_HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 54_321)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError):
        Path.home()


@pytest.mark.usefixtures("nobody")
@pytest.mark.parametrize(
    "words",
    [
        "list targets",
        "list targets --json",
        "list campaigns",
        "list policies",
        "list scorers",
        "list strategies",
        "mutate avoidance-m2 --count 1",
        "new policy mine",
        "schema campaign",
        "status",
    ],
)
def test_who_has_no_home_is_served(words: str, capfd: pytest.CaptureFixture[str]) -> None:
    code = main(words.split())
    said = capfd.readouterr()
    assert "fault of saflite itself" not in said.err
    assert code in (0, 2), said.err


@pytest.mark.usefixtures("nobody")
def test_who_has_no_home_keeps_nothing_where_anybody_could_put_it() -> None:
    assert cache_root() == Path("/nonexistent/.cache/saflite")


@pytest.mark.parametrize("kind", ["a file in its place", "no leave"])
def test_what_cannot_be_kept_is_asked_again(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "cache"
    if kind == "a file in its place":
        folder.write_text("")
    else:
        folder.mkdir()
        monkeypatch.setattr(Path, "write_bytes", lambda *_: (_ for _ in ()).throw(PermissionError(13, "no leave")))
    listing.remember(folder, FOUND)
    assert listing.known(folder, FOUND.binary) is None


def test_what_was_kept_is_known(tmp_path: Path) -> None:
    listing.remember(tmp_path, FOUND)
    assert listing.known(tmp_path, FOUND.binary) == FOUND
