"""What commands write is never put over what stands there, or through a link, unless the user says so."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.console.io import outputs
from saflite.console.operations.running import check_new
from saflite.contract.errors import Refused, Unavailable
from saflite.evidence.files import write_whole
from saflite.recorder.files import write_file


def test_a_new_file_is_written_with_its_folder(tmp_path: Path) -> None:
    outputs.write(tmp_path / "a" / "b.txt", b"new", force=False)
    assert (tmp_path / "a" / "b.txt").read_bytes() == b"new"
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b.txt"]


def test_what_stands_there_is_written_over_only_by_force(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(b"mine")
    with pytest.raises(Refused, match="--force"):
        outputs.write(path, b"new", force=False)
    assert path.read_bytes() == b"mine"
    outputs.write(path, b"new", force=True)
    assert path.read_bytes() == b"new"


@pytest.mark.parametrize("dangling", [True, False])
def test_a_link_is_replaced_by_force_and_never_followed(tmp_path: Path, dangling: bool) -> None:
    elsewhere, link = tmp_path / "elsewhere", tmp_path / "link"
    if not dangling:
        elsewhere.write_bytes(b"mine")
    link.symlink_to(elsewhere)
    with pytest.raises(Refused):
        outputs.write(link, b"new", force=False)
    outputs.write(link, b"new", force=True)
    assert not link.is_symlink()
    assert link.read_bytes() == b"new"
    assert elsewhere.exists() is not dangling
    assert dangling or elsewhere.read_bytes() == b"mine"


def test_a_folder_or_device_is_no_file_even_by_force(tmp_path: Path) -> None:
    for place in (tmp_path, Path("/dev/null")):
        with pytest.raises(Refused, match="a folder or device"):
            outputs.write(place, b"new", force=True)


def test_a_folder_with_files_takes_more_only_by_force(tmp_path: Path) -> None:
    outputs.check_folder(tmp_path / "new", force=False)
    outputs.check_folder(tmp_path, force=False)
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(Refused, match="new or empty"):
        outputs.check_folder(tmp_path, force=False)
    outputs.check_folder(tmp_path, force=True)
    with pytest.raises(Refused, match="a file or link"):
        outputs.check_folder(tmp_path / "file", force=True)


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(Unavailable, match="cannot be written"):
        outputs.write(tmp_path / "file" / "below", b"new", force=False)


def test_a_folder_that_takes_no_files_is_told_before_anything_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "access", lambda path, _mode: Path(path) != tmp_path)  # root may write anywhere
    out = str(tmp_path / "new" / "x.mcap")
    assert main(["fly", str(tmp_path / "none.yaml"), "--out", out]) == 3
    assert main(["regress", str(tmp_path / "none"), "--corpus", str(tmp_path / "known")]) == 3
    assert main(["mutate", "avoidance-m2", "--out", str(tmp_path / "cases")]) == 3
    said = capsys.readouterr()
    assert (said.out, said.err.count(f"{tmp_path} takes no new files; choose another place (--")) == ("", 3)


def test_a_name_too_long_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="300 bytes"):
        outputs.write(tmp_path / ("a" * 300), b"new", force=False)
    assert not list(tmp_path.iterdir())


def test_commands_refuse_before_they_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    link, full = tmp_path / "link.mcap", tmp_path / "full"
    link.symlink_to(tmp_path / "nowhere")
    full.mkdir()
    (full / "mine").write_bytes(b"")
    assert main(["fly", str(tmp_path / "none.yaml"), "--out", str(link)]) == 2
    assert main(["report", str(tmp_path / "none"), "--out", str(link)]) == 2
    assert main(["mutate", "avoidance-m2", "--out", str(full)]) == 2
    assert main(["export", str(tmp_path / "none"), "--format", "csv", "--out", str(full)]) == 2
    assert main(["artefacts", str(tmp_path / "none"), "--out", str(full)]) == 2
    assert capsys.readouterr().err.count("--force") >= 4
    assert not (tmp_path / "nowhere").exists()


def test_more_candidates_than_a_round_may_have_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["mutate", "avoidance-m2", "--count", "1000000000"]) == 2
    assert "at most 10000" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["a run", "a folder", "a link to nowhere"])
def test_a_run_never_begins_where_something_stands(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    if kind == "a link to nowhere":
        folder.symlink_to(tmp_path / "nowhere")
    else:
        folder.mkdir()
    if kind == "a run":
        (folder / "books.sqlite").touch()
    with pytest.raises(Refused, match="does not exist") as refused:
        check_new(folder)
    assert ("saflite resume" in str(refused.value)) == (kind == "a run")
    check_new(tmp_path / "new")


def test_a_run_in_a_working_folder_that_is_no_text_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"bad\xff")
    folder.mkdir()
    words = [sys.executable, "-m", "saflite", "run", "avoidance-m2", "--budget", "2"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert "run folder: expected a path that is text in UTF-8" in done.stderr
    assert not list(folder.iterdir())


WRITERS: tuple[Callable[[Path], None], ...] = (
    lambda path: outputs.write(path, b"new", force=False),
    lambda path: write_file(path, "new"),
    lambda path: write_whole(path, b"new"),
)


@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize(("mask", "mode"), [(0o077, 0o600), (0o027, 0o640), (0o022, 0o644)])
def test_others_may_read_what_is_written_as_far_as_the_user_lets_them(
    write: Callable[[Path], None], mask: int, mode: int, tmp_path: Path
) -> None:
    before = os.umask(mask)
    try:
        write(tmp_path / "file")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == mode
