"""The socket of a farm is this user's alone, short enough, and gone afterwards."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.bus.endpoints import UNIX_PATH_BYTES_MAX, check_endpoint
from saflite.bus.private_socket import LOCK_SUFFIX, PREFIX, PrivateSocket


@pytest.fixture(autouse=True)
def base(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where sockets go: pytest's own folders may be too long for one."""
    with tempfile.TemporaryDirectory(prefix="s-") as folder:
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        monkeypatch.setattr(tempfile, "tempdir", folder)
        yield Path(folder)


def test_nobody_else_may_enter_its_folder(base: Path) -> None:
    before = os.umask(0)
    try:
        with PrivateSocket() as socket:
            assert socket.folder.parent == base
            assert socket.folder.stat().st_mode & 0o777 == 0o700
            assert check_endpoint(socket.endpoint, insecure=False).text == socket.endpoint
    finally:
        os.umask(before)
    assert list(base.iterdir()) == []


def test_a_private_runtime_directory_is_taken_and_an_open_one_is_not(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = base / "user"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    with PrivateSocket() as socket:
        assert socket.folder.parent == runtime
    runtime.chmod(0o755)
    with PrivateSocket() as socket:
        assert socket.folder.parent == base
    link = base / "link"
    link.symlink_to(runtime)
    runtime.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(link))
    with PrivateSocket() as socket:
        assert socket.folder.parent == base


def test_a_path_too_long_for_a_socket_is_passed_over(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runtime = base / ("x" * 100)
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    with PrivateSocket() as socket:
        path = socket.endpoint.partition("/")[2]
        assert len(path) + len(LOCK_SUFFIX) <= UNIX_PATH_BYTES_MAX
        assert list(runtime.iterdir()) == []


def test_what_a_killed_farm_left_goes_at_the_next_start_and_what_lives_stays(base: Path) -> None:
    living, killed = PrivateSocket(), PrivateSocket()
    os.close(killed._lock)  # as the system does when a process dies
    (killed.folder / "bus").touch()
    stranger = base / f"{PREFIX}others"
    stranger.mkdir(mode=0o755)
    with PrivateSocket():
        assert not killed.folder.exists()
        assert living.folder.exists()
        assert stranger.exists(), "a folder that is not private is none of ours"
    living.close()
    living.close()
