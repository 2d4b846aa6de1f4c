"""A run that a full disk does not let begin leaves nothing that the next try would be refused for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BEGIN_ON_SMALL_DISKS = """
import os, subprocess, sys
from pathlib import Path

import saflite.contract.modules
from saflite.campaign.storage.audit import audit
from saflite.console.cli import main
from saflite.console.io import campaign_options
from saflite.console.operations import running
from saflite.contract.errors import Unavailable
from saflite.simulator_worker.registry import describe_target

disk = Path(sys.argv[1])
saflite.contract.modules.use([Path(sys.argv[2])])
campaign = campaign_options.load("avoidance-m2", "")
target = describe_target(campaign.target.name)

def begin(run_dir):
    running.check_new(run_dir)
    running.create(run_dir, campaign, target)

sizes = [("size", pages * 4096) for pages in (1, 2, 4, 8, 16, 20, 24, 28, 32, 36, 40, 48, 64, 96, 256)]
for option, value in sizes + [("nr_inodes", count) for count in range(2, 16)]:
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"mode=0700,{option}={value}", "none", disk])
    mounted.returncode and sys.exit(77)
    try:
        begin(disk / "run")
    except Unavailable:
        assert not list(disk.iterdir()), (option, value, list(disk.rglob("*")))
        subprocess.run(["mount", "-o", "remount,size=64m,nr_inodes=1000", disk], check=True)
        begin(disk / "run")
        print("full", end=" ")
    else:
        print("made", end=" ")
    assert audit(disk / "run", quick=True, blobs=False)["clean"]
    assert sorted(path.name for path in (disk / "run" / "modules").iterdir())
    left_open = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if os.path.exists(link)]
    assert not [name for name in left_open if name.startswith(str(disk))], (option, value, left_open)
    subprocess.run(["umount", disk], check=True)
"""


def test_a_run_begins_whole_or_not_at_all(tmp_path: Path) -> None:
    disk, module = tmp_path / "disk", tmp_path / "hopper.py"
    disk.mkdir()
    assert subprocess.run(
        [sys.executable, "-m", "saflite", "new", "target", "hopper"], cwd=tmp_path, capture_output=True, check=True
    )
    words = ["unshare", "--user", "--map-root-user", "--mount", sys.executable, "-c", BEGIN_ON_SMALL_DISKS]
    done = subprocess.run([*words, str(disk), str(module)], capture_output=True, text=True, check=False)
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("no file system of one's own here")
    assert done.returncode == 0, done.stderr
    assert {"full", "made"} == set(done.stdout.split()), "from too little room to enough"
