"""Results survive the worker."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from saflite.contract.errors import Unavailable
from saflite.contract.work import Failure, Report
from saflite.runtime.spool import Spool


def _report(lease: str, epoch: int = 1) -> Report:
    return Report(worker="w", lease_id=lease, epoch=epoch, result=Failure(message="why"))


def test_what_is_kept_is_found_by_the_next_life(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "w")
    reports = [_report("a"), _report("a", 2), _report("b/../c")]
    for report in reports:
        spool.keep(report)
    assert Spool(tmp_path / "w").waiting() == reports


def test_what_is_forgotten_is_gone(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    spool.keep(_report("a"))
    spool.forget("a", 1)
    spool.forget("never", 1)
    assert Spool(tmp_path).waiting() == []


def test_damaged_results_are_set_aside_and_the_rest_is_read(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    for name in "abc":
        spool.keep(_report(name))
    (tmp_path / "a.1.report").write_bytes((tmp_path / "a.1.report").read_bytes()[:-3])
    flipped = bytearray((tmp_path / "b.1.report").read_bytes())
    flipped[-1] ^= 1
    (tmp_path / "b.1.report").write_bytes(bytes(flipped))
    (tmp_path / "half.part").write_bytes(b"torn")
    assert Spool(tmp_path).waiting() == [_report("c")]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.1.damaged", "b.1.damaged", "c.1.report"]


ON_A_READ_ONLY_DISK = """
import subprocess, sys
from pathlib import Path

from saflite.contract.errors import Unavailable
from saflite.contract.work import Failure, Report
from saflite.evidence.folder import BlobFolder
from saflite.runtime.spool import Spool

disk = Path(sys.argv[1])
subprocess.run(["mount", "-t", "tmpfs", "-o", "mode=0700", "none", disk]).returncode and sys.exit(77)
report = Report(worker="w", lease_id="a", epoch=1, result=Failure(message="why"))
Spool(disk / "w").keep(report)
(disk / "w" / "torn.part").write_bytes(b"half")
(disk / "w" / "bad.1.report").write_bytes(b"damaged")
store = BlobFolder(disk / "run")
store.incoming("w").mkdir(parents=True)
(store.incoming("w") / ("a" * 64)).write_bytes(b"left")
subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
for folder in (disk / "w", disk / "not-made"):
    spool = Spool(folder)
    assert spool.waiting() == ([report] if folder.exists() else [])
    try:
        spool.keep(report)
    except Unavailable as fault:
        print("told:", fault)
    spool.forget("a", 1)
    spool.forget("never", 1)
store.forget_but("w", ())
"""


def test_a_disk_that_has_become_read_only_costs_no_result(tmp_path: Path) -> None:
    words = ["unshare", "--user", "--map-root-user", "--mount", sys.executable, "-c", ON_A_READ_ONLY_DISK]
    done = subprocess.run([*words, str(tmp_path)], capture_output=True, text=True, check=False)
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("no file system of one's own here")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("told: ") == 2, "the shell sends the result all the same"


def test_a_run_folder_that_was_moved_away_is_not_made_anew(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    run_dir.mkdir()
    Spool(run_dir / "spool" / "w", run_dir).keep(_report("a"))
    run_dir.rename(tmp_path / "moved")
    with pytest.raises(Unavailable, match="spool"):
        Spool(run_dir / "spool" / "w", run_dir).keep(_report("b"))
    assert not run_dir.exists()
