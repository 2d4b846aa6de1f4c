"""A report says when and by what its run was made, and is the same byte for byte when it is written again."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.io import campaign_options
from saflite.console.io.toml_text import dump
from saflite.console.run_data import provenance
from saflite.flight.autopilots.reference.describe import describe

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver

BEGUN_UNIX_S = 1_700_000_000.0


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=3, rng_seed=4711)
    store = Store.create(tmp_path / "run", campaign, template(campaign), describe())
    (tmp_path / "run" / "campaign.toml").write_text(dump(campaign))
    provenance.note(tmp_path / "run", describe())
    Driver(store.rebuild(), store, BEGUN_UNIX_S).run()
    store.close()
    return tmp_path / "run"


def _report(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> bytes:
    monkeypatch.chdir(run_dir.parent)
    assert main(["report", "run"]) == 0
    return (run_dir / "report.html").read_bytes()


def test_its_foot_tells_when_and_by_what(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = _report(run_dir, monkeypatch).decode()
    software = provenance.read(run_dir)
    assert software is not None
    foot = text.partition("<footer")[2].partition("</footer>")[0]
    assert "begun 2023-11-14 22:13:20 UTC" in foot
    assert "ended 2023-11-14 22:" in foot
    for words in (
        f"saflite {software.saflite}",
        f"build {describe().build[:16]}",
        "random seed 4711",
        "campaign avoidance-m2, as it was run: campaign.toml",
    ):
        assert words in foot


def test_it_is_the_same_elsewhere_and_later(run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = _report(run_dir, monkeypatch)
    assert str(tmp_path).encode() not in first
    monkeypatch.setattr(provenance, "library_version", lambda _name: "another")
    (tmp_path / "elsewhere").mkdir()
    shutil.copytree(run_dir, tmp_path / "elsewhere" / "run")
    assert _report(tmp_path / "elsewhere" / "run", monkeypatch) == first


def test_a_run_without_the_note_and_one_with_a_damaged_one_say_the_rest(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for note in (b"{", None):
        (run_dir / provenance.FILE).unlink() if note is None else (run_dir / provenance.FILE).write_bytes(note)
        text = _report(run_dir, monkeypatch).decode()
        assert "random seed 4711" in text
        assert "saflite " not in text.partition("<footer")[2]
