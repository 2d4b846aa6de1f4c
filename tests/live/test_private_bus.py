"""The default endpoint of a farm is closed to other users of the machine, on the real bus."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import other_user
import pytest

from saflite.bus.private_socket import SOCKET, PrivateSocket
from saflite.bus.zenoh import open_client, open_router

pytestmark = pytest.mark.live

KNOCK = "import socket, sys; socket.socket(socket.AF_UNIX).connect(sys.argv[1])"


def _knock(path: Path, *prefix: str) -> str:
    """Return what connecting to the socket in a process of its own ends with, empty if it succeeds."""
    done = subprocess.run(
        [*prefix, other_user.PYTHON, "-c", KNOCK, str(path)], capture_output=True, text=True, check=False
    )
    return done.stderr.strip().splitlines()[-1] if done.returncode else ""


@pytest.fixture
def stranger() -> tuple[str, ...]:
    """What runs a command as another user."""
    return other_user.prefix()


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that everybody may enter."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


def test_another_user_cannot_connect_to_a_private_socket(stranger: tuple[str, ...]) -> None:
    with PrivateSocket() as socket:
        router = open_router("books", socket.endpoint)
        assert _knock(socket.folder / SOCKET) == ""
        assert "PermissionError" in _knock(socket.folder / SOCKET, *stranger)
        router.close()


def test_nor_to_one_in_an_open_folder_whatever_the_umask(stranger: tuple[str, ...], open_folder: Path) -> None:
    before = os.umask(0)
    try:
        router = open_router("books", f"unixsock-stream/{open_folder / 'farm'}")
        assert os.umask(0) == 0, "the caller's umask was not put back"
    finally:
        os.umask(before)
    assert (open_folder / "farm").stat().st_mode & 0o077 == 0
    assert _knock(open_folder / "farm") == ""
    assert "PermissionError" in _knock(open_folder / "farm", *stranger)
    router.close()


def test_a_router_takes_the_place_of_one_that_was_closed() -> None:
    with PrivateSocket() as socket:
        for _ in range(2):
            router = open_router("books", socket.endpoint)
            client = open_client("worker", socket.endpoint, patience_s=6.0)
            client.close()
            router.close()
