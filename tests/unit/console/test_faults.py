"""A fault of our own never looks like a violation: one line, a log file, exit code 3."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from saflite.console import cli


def test_any_exception_is_one_line_and_exit_code_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken(words: list[str]) -> int:
        raise ZeroDivisionError("first line\nsecond line")

    monkeypatch.setattr(cli, "_dispatch", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert cli.main(["list"]) == cli.INFRASTRUCTURE
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "ZeroDivisionError: first line" in said
    [log] = tmp_path.glob("saflite-*.log")
    assert str(log) in said
    assert "in broken" in log.read_text()


def test_code_from_outside_does_not_end_us_without_a_word(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    at_once, asked = tmp_path / "at_once.py", tmp_path / "asked.py"
    at_once.write_text("import sys\nsys.exit(0)")
    asked.write_text(
        "class Strategy:\n"
        "    proposes, options, tell, ask = 'obstacles', {}, None, None\n"
        "    def __init__(self, *given): raise SystemExit(0)\n"
    )
    told = {
        at_once: "expected Python that runs, got SystemExit: 0",
        asked: "strategy asked raised SystemExit (asked.py line 3): 0",
    }
    for file, words_told in told.items():
        words = ["mutate", "avoidance-m2", "--strategy", "asked", "--module", str(file)]
        assert cli.main(words) == cli.REFUSED
        said = capsys.readouterr().err
        assert words_told in said
        assert said.count("\n") == 1


@pytest.mark.parametrize("fault", [MemoryError(), ImportError("x.so: failed to map segment from shared object")])
def test_too_little_memory_is_no_fault_of_ours(
    fault: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def starved(words: list[str]) -> int:
        raise fault

    monkeypatch.setattr(cli, "_dispatch", starved)
    assert cli.main(["list"]) == cli.INFRASTRUCTURE
    said = capsys.readouterr().err
    assert said.startswith("saflite: unavailable: this process was given too little memory")
    assert said.count("\n") == 1


def test_files_of_no_size_are_told_of_as_such() -> None:
    """The library says that it found no folder; nothing is wrong with the folders."""
    words = ["sh", "-c", 'ulimit -f 0; exec "$@"', "sh", sys.executable, "-m", "saflite", "worker", "--join"]
    done = subprocess.run([*words, "unixsock-stream//nowhere/bus"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (cli.INFRASTRUCTURE, 1), done.stderr
    assert "files are limited" in done.stderr


def test_children_are_heard_of_where_who_started_us_ignores_theirs() -> None:
    code = "import signal; from saflite.console.cli import main; signal.signal(signal.SIGCHLD, signal.SIG_IGN); "
    code += "main(['--version']); assert signal.getsignal(signal.SIGCHLD) == signal.SIG_DFL"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_a_panic_of_a_library_is_no_violation(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class PanicException(BaseException):
        """As libraries in Rust raise it."""

    def panics(words: list[str]) -> int:
        raise PanicException("called `Result::unwrap()` on an `Err` value")

    monkeypatch.setattr(cli, "_dispatch", panics)
    assert cli.main(["list"]) == cli.INFRASTRUCTURE
    assert capsys.readouterr().err.count("\n") == 1
