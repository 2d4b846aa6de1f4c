"""What an autopilot's process is given, none of our secrets, and what is taken from it, no more than there may be."""

from __future__ import annotations

import ast
import os
import subprocess
from pathlib import Path
from typing import Any, cast

import pytest

import saflite
from saflite.contract.config import environment_of_program
from saflite.flight.autopilots import console
from saflite.flight.autopilots.external import process as external_process
from saflite.flight.autopilots.external.aircraft import Aircraft
from saflite.flight.autopilots.external.process import Process

FLIGHT = Path(saflite.__file__).parent / "flight"
OURS = ("standalone/", "aerialist/container.py", "betaflight/install.py")
"""Scripts that fly without the farm, the client of a container engine, which finds its server by its variables, and
compilers."""


def test_no_secret_of_ours_stands_in_the_environment_of_an_autopilot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that stood in a worker's environment did; what a build prints is kept with its flight, for all to read."""
    for name in ("OPENAI_API_KEY", "OLLAMA_API_KEY", "RAY_AUTH_TOKEN", "AWS_SECRET_ACCESS_KEY", "LD_PRELOAD", "ANY"):
        monkeypatch.setenv(name, "secret")
    monkeypatch.setenv("ASAN_OPTIONS", "detect_leaks=0")
    process = Process(["/usr/bin/env"], tmp_path, environment=environment_of_program(SAFLITE_GATE="3"))
    assert process.how_it_ended().startswith("the autopilot ended with exit code 0")
    assert "secret" not in process.console
    assert {"ASAN_OPTIONS=detect_leaks=0", "SAFLITE_GATE=3"} <= set(process.console.split())
    process.end()


def test_no_program_of_others_is_started_in_our_environment() -> None:
    wrong = []
    for path in FLIGHT.rglob("*.py"):
        place = path.relative_to(FLIGHT).as_posix()
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and not any(part in place for part in OURS):
                called, words = ast.unparse(call.func), {word.arg for word in call.keywords}
                if called == "environment_with" or (called.startswith("subprocess.") and "env" not in words):
                    wrong.append(f"{place} line {call.lineno}")
    assert wrong == []


def test_a_program_that_prints_without_end_fills_a_bounded_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the firmware and forks of autopilots print lies in memory: some gigabytes in a flight."""
    monkeypatch.setattr(console, "BYTES_MAX", 2**16)
    file = console.open_console()
    reader, writer = os.pipe()
    words = ["/bin/sh", "-c", f"echo first; yes; echo goes on >/proc/self/fd/{writer}"]
    try:
        subprocess.run(words, stdout=file, stderr=subprocess.DEVNULL, pass_fds=[writer], check=False)
        assert os.read(reader, 100) == b"goes on\n"
        assert os.fstat(file).st_size == 2**16
        assert set(console.printed(file, 100).split()) == {b"y"}
        assert len(console.printed(file, 2**30)) <= 2**16
    finally:
        for handle in {file, reader, writer}:
            os.close(handle)


def test_a_file_that_a_program_writes_without_end_ends_and_the_program_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log without end filled the disk of its host; a signal in its place would pass for a death in flight."""
    monkeypatch.setattr(external_process, "FILE_BYTES_MAX", 2**16)
    words = ["/bin/sh", "-c", "cat /dev/zero >log; echo goes on"]
    process = Process(words, tmp_path, environment={"PATH": os.defpath}, age_max_s=30.0)
    try:
        assert process.wait_for_words("goes on", 30.0), process.console
        assert (tmp_path / "log").stat().st_size == 2**16
        assert process.how_it_ended().startswith("the autopilot ended with exit code 0")
    finally:
        process.end()


def test_a_death_by_a_signal_without_a_name_is_told_as_one(tmp_path: Path) -> None:
    """It was a fault of ours in place of an end of the autopilot's: the flight counted as lost, and was flown again."""
    words = ["/bin/sh", "-c", "echo last words; kill -40 $$"]  # a real-time signal
    process = Process(words, tmp_path, environment={"PATH": os.defpath})
    assert process.how_it_ended() == "the autopilot ended with signal 40: last words"
    process.end()


class _Left(Aircraft):
    """An aircraft of which only the logs are left."""

    def __init__(self, logs: list[Path]) -> None:
        self._logs = logs
        self.process = cast(Any, type("Silent", (), {"console": "said"}))

    def _bring_up(self, opened: Any) -> None: ...

    def logs(self) -> list[Path]:
        return self._logs


def test_only_a_log_of_a_logs_size_is_taken_for_one(tmp_path: Path) -> None:
    """A link would have sent any file of the worker's machine to the farm, a pipe held it, a sparse file ended it."""
    good, link, pipe, huge = (tmp_path / name for name in ("good.BIN", "link.BIN", "pipe.BIN", "huge.BIN"))
    good.write_bytes(b"log")
    (tmp_path / "key").write_text("secret")
    link.symlink_to(tmp_path / "key")
    os.mkfifo(pipe)
    with huge.open("wb") as file:
        file.truncate(2**40)
    said = ("console.txt", b"said")
    assert _Left([good]).artefacts("a.bin") == (said, ("a.bin", b"log"))
    assert _Left([good, link]).artefacts("a.bin") == (said, ("a.bin", b"log"))
    for odd in (pipe, huge):
        assert _Left([good, odd]).artefacts("a.bin") == (said,)
    assert _Left([]).artefacts("a.bin") == (said,)
