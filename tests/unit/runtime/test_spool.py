"""Results survive the worker."""

from __future__ import annotations

from pathlib import Path

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
