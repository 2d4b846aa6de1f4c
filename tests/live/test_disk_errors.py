"""A disk that gives input/output errors for a while: it is said, nothing is lost, and the campaign goes on after it.

The disk is real to the farm: a file system on a loop device whose own file lies on a file system without room. What is
written there is taken, and fails as it is flushed. Needs root.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

pytestmark = pytest.mark.live
LACKING = [word for word in ("losetup", "mkfs.ext4", "mount", "umount") if shutil.which(word) is None]
if os.geteuid() != 0:
    LACKING.append("root")
CAMPAIGN = ["policy-a-chute", "--defect", "parachute-in-acro", "--budget", "80", "--rng-seed", "3"]
GOES_ON_S = 120.0


def call(*words: str) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


class Disk(NamedTuple):
    """What the farm writes to, and what lies under it."""

    folder: Path
    under: Path

    def give_room(self) -> None:
        call("mount", "-o", "remount,size=80m", str(self.under))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    folder, under = tmp_path / "disk", tmp_path / "under"
    folder.mkdir()
    under.mkdir()
    undo: list[tuple[str, ...]] = []
    try:
        try:
            call("mount", "-t", "tmpfs", "-o", "size=5m", "tmpfs", str(under))
            undo.append(("umount", str(under)))
            image = under / "image"
            with image.open("wb") as file:
                file.truncate(200 * 2**20)
            device = call("losetup", "--find", "--show", str(image))
            undo.append(("losetup", "--detach", device))
            call("mkfs.ext4", "-q", "-O", "^has_journal", "-E", "lazy_itable_init=0", "-N", "4000", device)
            call("mount", device, str(folder))
            undo.append(("umount", str(folder)))
        except subprocess.CalledProcessError as fault:
            pytest.skip(f"no loop device can be mounted here: {fault.cmd[0]}: {fault.stderr.strip()}")
        yield Disk(folder, under)
    finally:
        for words in reversed(undo):
            call(*words)


def told(run: subprocess.Popen[str], word: str) -> str:
    """Return what was said up to the first line with a word."""
    assert run.stdout is not None
    said, until_s = "", time.monotonic() + GOES_ON_S
    for line in run.stdout:
        said += line
        if word in line:
            return said
        assert time.monotonic() < until_s, said
    raise AssertionError(said)


@pytest.mark.skipif(bool(LACKING), reason=f"needs {', '.join(LACKING)}")
def test_a_disk_with_errors_for_a_while_costs_time_alone(disk: Disk) -> None:
    run_dir = disk.folder / "run"
    words = [sys.executable, "-m", "saflite"]
    command = [*words, "run", *CAMPAIGN, "--out", str(run_dir)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as run:
        said = told(run, "nothing goes on")
        assert "disk I/O error" in said
        disk.give_room()
        assert run.stdout is not None
        said += run.stdout.read()
    assert run.returncode == 1, said
    assert "80 flights in" in said
    audit = subprocess.run([*words, "audit", str(run_dir)], capture_output=True, text=True, check=False)
    assert audit.returncode == 0, audit.stdout + audit.stderr
    undisturbed = disk.folder / "undisturbed"
    subprocess.run([*words, "run", *CAMPAIGN, "--out", str(undisturbed)], capture_output=True, check=False)
    assert found(run_dir) == found(undisturbed)


def found(run_dir: Path) -> set[str]:
    names = {path.stem for path in (run_dir / "test_cases").iterdir()}
    assert names
    return names
