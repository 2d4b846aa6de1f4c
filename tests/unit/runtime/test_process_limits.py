"""What a machine must allow the processes of a farm: told in one line before anything is made."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from saflite.runtime.process_limits import FILES, FILES_PER_WORKER

RUN = (sys.executable, "-m", "saflite", "run", "avoidance-m2", "--budget", "4", "--workers", "3", "--out", "run")
PREPARED = "from saflite.runtime.process_limits import prepare_limits as p; p(); import resource as r; "
SOFT = "print(r.getrlimit(r.RLIMIT_NOFILE)[0])"


def _limited(limit: str, words: tuple[str, ...], folder: Path) -> subprocess.CompletedProcess[str]:
    command = ["bash", "-c", f'ulimit {limit} && exec "$@"', "bash", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("limit", "told"),
    [
        ("-n 40", f"limit of open files: expected at least {FILES + 9 * FILES_PER_WORKER}, with 9 processes, got 40"),
        (f"-n {FILES + 4}", f"got {FILES + 4}"),  # enough for one process, not for the farm
        ("-v 600000", "limit of memory: expected at least 1000000 KiB for each process, got 600000 KiB"),
    ],
)
def test_a_farm_that_cannot_begin_is_refused_before_anything_is_made(limit: str, told: str, tmp_path: Path) -> None:
    done = _limited(limit, RUN, tmp_path)
    assert done.returncode == 2, done.stderr
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_workers_that_cannot_begin_are_refused_too(tmp_path: Path) -> None:
    join = (sys.executable, "-m", "saflite", "worker", "--join", "unixsock-stream/nowhere", "--patience", "1")
    done = _limited("-n 40", join, tmp_path)
    assert done.returncode == 2, done.stderr
    assert f"at least {FILES}, got 40" in done.stderr


@pytest.mark.parametrize(
    ("limits", "soft"), [("-Sn 100 && ulimit -Hn 3000", 3000), ("-Sn 100 && ulimit -Hn 17000", 16384)]
)
def test_the_soft_limit_is_raised_as_far_as_may_be(limits: str, soft: int, tmp_path: Path) -> None:
    done = _limited(limits, (sys.executable, "-c", PREPARED + SOFT), tmp_path)
    assert (done.returncode, done.stdout) == (0, f"{soft}\n"), done.stderr


def test_a_limit_that_is_high_enough_is_left_alone(tmp_path: Path) -> None:
    done = _limited("-n 17000", (sys.executable, "-c", PREPARED + SOFT), tmp_path)
    assert done.stdout == "17000\n"
