"""Output that nobody takes: full, closed, or read no further. No traceback, nothing lost, and never exit code 1."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from saflite.bus import keyring
from saflite.console.cli import BROKEN_PIPE, INFRASTRUCTURE, NOTHING_FOUND, REFUSED

SAYS: tuple[list[str], ...] = (
    [],
    ["--version"],
    ["run", "--help"],
    ["keys", "init", "--help"],
    ["list", "scorers"],
    ["schema", "campaign"],
)
COMMAND = (sys.executable, "-m", "saflite")
BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}


def _ended(words: Sequence[str], redirected: str) -> tuple[int, str]:
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {redirected}', "sh", *COMMAND, *words],
        capture_output=True,
        text=True,
        check=False,
        env=BUFFERED,
    )
    return done.returncode, done.stderr


@pytest.fixture
def unread() -> Iterator[int]:
    """The writing end of a pipe that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)
    yield writing
    os.close(writing)


@pytest.mark.parametrize("words", SAYS, ids=" ".join)
def test_a_full_disk_is_said_once(words: list[str]) -> None:
    code, said = _ended(words, ">/dev/full")
    assert (code, said.count("\n")) == (INFRASTRUCTURE, 1), said
    assert "No space left" in said
    assert _ended(words, ">/dev/full 2>&1") == (INFRASTRUCTURE, "")


@pytest.mark.parametrize("words", SAYS, ids=" ".join)
def test_a_reader_that_has_gone_is_no_fault(words: list[str], unread: int) -> None:
    done = subprocess.run(
        [*COMMAND, *words], stdout=unread, stderr=subprocess.PIPE, text=True, check=False, env=BUFFERED
    )
    assert (done.returncode, done.stderr) == (BROKEN_PIPE, "")
    assert (
        subprocess.run([*COMMAND, *words], stdout=unread, stderr=unread, check=False, env=BUFFERED).returncode
        == BROKEN_PIPE
    )


@pytest.mark.parametrize("words", SAYS, ids=" ".join)
def test_closed_output_is_output_to_nowhere(words: list[str]) -> None:
    for redirected in (">&-", "<&- >&-", "<&- >&- 2>&-"):
        assert _ended(words, redirected) == (NOTHING_FOUND, ""), redirected


@pytest.mark.parametrize("redirected", ["2>/dev/full", ">/dev/full 2>&1", "2>&-", "<&- >&- 2>&-"])
def test_what_is_refused_is_refused_where_nobody_hears_it(redirected: str) -> None:
    assert _ended(["run", "no-such-campaign"], redirected)[0] == REFUSED
    assert _ended(["run", "--no-such-option"], redirected)[0] == REFUSED


def test_no_file_of_ours_stands_where_output_was_closed(tmp_path: Path) -> None:
    """A library that writes to descriptor 2 would write into it."""
    program = (
        "import os, sys\n"
        "from saflite.console.cli import main\n"
        "main(['--version'])\n"
        "assert os.open(sys.argv[1], os.O_CREAT | os.O_WRONLY) > 2\n"
    )
    words = [sys.executable, "-c", program, str(tmp_path / "file")]
    assert subprocess.run(["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *words], check=False).returncode == 0


@pytest.mark.parametrize(
    "verb", [["init", "--host", "h"], ["add", "b", "--role", "viewer"], ["list"], ["revoke", "a"], ["renew"]]
)
def test_keys_are_not_blamed_for_where_their_words_go(verb: list[str], tmp_path: Path, unread: int) -> None:
    with open("/dev/full", "wb") as full:
        for output, code, told in ((full.fileno(), INFRASTRUCTURE, "No space left"), (unread, BROKEN_PIPE, "")):
            keys = tmp_path / f"keys{code}"
            if verb[0] != "init":
                keyring.init(keys, ["h"], now_s=time.time())
                keyring.add(keys, "a", ["viewer"], now_s=time.time(), days=9)
            words = [*COMMAND, "keys", *verb, "--keys", str(keys)]
            done = subprocess.run(words, stdout=output, stderr=subprocess.PIPE, text=True, check=False, env=BUFFERED)
            assert done.returncode == code, done.stderr
            assert told in done.stderr
            assert str(keys) not in done.stderr
