"""What the books cost: results per second and their share of a core with every commit on disk, memory, store, resume.

The services are the scripted ones of the simulated farm (`tests/farm`), in a process of their own; every message is
encoded and decoded, traces are those of real flights in size (`--trace-kib`), each result is committed on its own or in
batches of `--together`. Blobs are looked at by a thread of the books' process beside the books; what that costs is
told apart, or left out (`--placed`). `resume` is a new process that opens the run, with and without its snapshot, and
`killed` one that opens it as it stood before it was closed, with the snapshot that was last due.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from _books_page import page, rows
from _books_services import FARM, LEAVES, Services

if TYPE_CHECKING:
    from saflite.campaign.storage.store import Store
    from saflite.contract.control import Status

WORKERS = ("a", "b")
HERE = Path(__file__).resolve().parent
ROWS = HERE / "results" / "books.jsonl"
PAGE = HERE.parents[1] / "deploy" / "docs" / "books.md"


def main(argv: list[str]) -> int:
    """Measure and print; 0."""
    parser = argparse.ArgumentParser(prog="scripts/bench books", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=2000, help="flights flown, re-flights included")
    parser.add_argument("--together", type=int, default=4, help="leases taken and results committed together")
    parser.add_argument("--placed", action="store_true", help="nobody looks at blobs: long runs take half the time")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="end before all are flown")
    parser.add_argument("--trace-kib", type=int, default=100, help="size of a packed trace")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="make the run here and leave it")
    parser.add_argument("--resume", type=Path, help="only open this run and work out its books")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--note", default="", help="add a row to results/books.jsonl, with these words about the machine"
    )
    parser.add_argument("--page", action="store_true", help="write deploy/docs/books.md from the rows, run nothing")
    options = parser.parse_args(argv)
    sys.path.insert(0, str(FARM))
    if options.page:
        PAGE.write_text(page(rows(ROWS)), encoding="utf-8")
        return 0
    if options.resume:
        figures = _resumed(options.resume)
    else:
        with tempfile.TemporaryDirectory() as folder:
            figures = _measure(options.keep or Path(folder) / "run", options)
    if options.note:
        with ROWS.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"commit": _commit(), "note": options.note, **figures}) + "\n")
    if options.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:32} {value:,.2f}" if isinstance(value, float) else f"{name:32} {value:,}")
    return 0


def _commit() -> str:
    command = ["git", "-C", str(HERE), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def _measure(run_dir: Path, options: argparse.Namespace) -> dict[str, float | int]:
    import farm_doubles as doubles

    from saflite.campaign.storage.store import Store

    services = Services(run_dir, options.trace_kib, placed=options.placed)
    search: dict[str, Any] = {"candidates_per_round": 40, "flights_per_round": 8, "lag": 3}
    campaign = doubles.campaign(options.flights, batch=10, **search)
    store = Store.create(run_dir, campaign, doubles.TEMPLATE, doubles.TARGET)
    drive = _Drive(store, services, options.together, looks=not options.placed)
    begun_mib = _memory_mib("VmRSS")
    drive.run(options.flights, time.perf_counter() + 60.0 * options.minutes)
    services.close()
    killed_dir = run_dir.with_name(f"{run_dir.name}_killed")
    shutil.copytree(run_dir, killed_dir, ignore=shutil.ignore_patterns("blobs", "recordings"))
    drive.keep()
    store.close()
    database_mb = (run_dir / "books.sqlite").stat().st_size / 1e6
    return {
        "flights": drive.flights,
        "results": drive.results,
        "together": options.together,
        "trace_kib": options.trace_kib,
        "results_per_cpu_s": drive.results / drive.books_cpu_s,
        "core_share_at_500_per_s": 500.0 * drive.books_cpu_s / drive.results,
        "results_per_wall_s": drive.results / drive.books_wall_s,
        **_looking(drive),
        "memory_begun_mib": begun_mib,
        "memory_peak_mib": _memory_mib("VmHWM"),
        "database_mb": database_mb,
        "database_kb_per_flight": 1000.0 * database_mb / drive.flights,
        "snapshots": drive.kept,
        "snapshot_mb": (run_dir / "books.snapshot").stat().st_size / 1e6,
        "snapshot_core_share": drive.keeping_cpu_s / drive.books_cpu_s,
        **_in_a_new_process(killed_dir, "killed"),
        **_in_a_new_process(run_dir, "resume"),
        **_without_snapshot(run_dir),
    }


def _looking(drive: _Drive) -> dict[str, float | int]:
    if not drive.blobs_cpu_s:
        return {}
    return {
        "blobs_core_share_at_500_per_s": 500.0 * drive.blobs_cpu_s / drive.results,
        "results_per_cpu_s_with_blobs": drive.results / (drive.books_cpu_s + drive.blobs_cpu_s),
    }


def _without_snapshot(run_dir: Path) -> dict[str, float | int]:
    (run_dir / "books.snapshot").unlink(missing_ok=True)
    return _in_a_new_process(run_dir, "replay")


def _in_a_new_process(run_dir: Path, name: str) -> dict[str, float | int]:
    command = [sys.executable, sys.argv[0], "books", "--json", "--resume", str(run_dir)]
    answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return {f"{name}_{key}": value for key, value in json.loads(answer).items()}


def _resumed(run_dir: Path) -> dict[str, float | int]:
    from saflite.campaign.storage.store import Store

    started_s, started_cpu_s = time.perf_counter(), time.process_time()
    store = Store.open(run_dir)
    opened_s = time.perf_counter() - started_s
    books = store.rebuild()
    taken = {"open_s": opened_s, "s": time.perf_counter() - started_s, "cpu_s": time.process_time() - started_cpu_s}
    flights, behind = _flown(books.status(0.0)), store.lines_behind
    store.close()
    return {**taken, "lines_behind": behind, "memory_peak_mib": _memory_mib("VmHWM"), "flights": flights}


def _flown(status: Status) -> int:
    return status.flights + status.reflown


def _memory_mib(name: str) -> float:
    """Return `VmRSS` (now) or `VmHWM` (the most so far) of this process."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024.0


class _Drive:
    """Runs a campaign; only the time inside the books, their messages and their store is counted."""

    def __init__(self, store: Store, services: Services, together: int, *, looks: bool) -> None:
        from saflite.contract.join import Join
        from saflite.contract.topics import PROTOCOL, STAGES

        self._store, self._services, self._together, self._looks = store, services, together, looks
        self._books = store.rebuild()
        self._now = 0.0
        self.results, self.books_cpu_s, self.books_wall_s, self.blobs_cpu_s = 0, 0.0, 0.0, 0.0
        self.keeping_cpu_s, self.kept = 0.0, 0
        self._books.begin(0.0, 1.7e9)
        for stage in STAGES:
            for worker in WORKERS:
                self._books.join(Join(protocol=PROTOCOL, worker=worker, stage=stage), 0.0)

    @property
    def flights(self) -> int:
        """How many were flown, re-flights included."""
        return _flown(self._books.status(self._now))

    def keep(self) -> None:
        """Keep the state of the books, as their service does now and then."""
        cpu_s = time.process_time()
        self._store.keep(self._books.snapshot())
        self.keeping_cpu_s += time.process_time() - cpu_s
        self.kept += 1

    def run(self, flights: int, until_s: float) -> None:
        """Run until so many flights were flown, or `time.perf_counter` says `until_s`."""
        from saflite.contract.topics import STAGES

        while not self._books.ended and self.flights < flights and time.perf_counter() < until_s:
            for stage in STAGES:
                for worker in WORKERS:
                    self._turn(stage, worker)
            self._now += 0.05
            self._timed(self._pass_time)

    def _pass_time(self) -> bytes:
        self._books.tick(self._now)
        self._store.commit(self._books.drain())
        if self._store.snapshot_due:
            self.keep()
        return b""

    def _turn(self, stage: str, worker: str) -> None:
        from saflite.contract import wire
        from saflite.contract.work import Ask

        cursor = self._services.cursor if stage in ("mutate", "score") else -1
        ask = wire.encode(Ask(worker=worker, stage=stage, leases_max=self._together, cursor=cursor))  # type: ignore[arg-type]
        reports = self._services.do(self._timed(lambda: self._asked(ask)), worker)
        if reports:
            damage = self._looked_at(reports)
            self._timed(lambda: self._reported(reports, damage))
            self.results += len(reports)

    def _asked(self, ask: bytes) -> bytes:
        from saflite.contract import wire
        from saflite.contract.work import Ask

        grant = self._books.ask(wire.decode(ask, Ask), self._now)
        self._store.commit(self._books.drain())
        return wire.encode(grant)

    def _looked_at(self, reports: list[bytes]) -> list[str]:
        from saflite.contract import wire
        from saflite.contract.work import Report, blobs_left
        from saflite.runtime.evidence import look

        if not self._looks:
            return [""] * len(reports)
        cpu_s = time.process_time()
        decoded = [msgspec.structs.replace(wire.decode(report, Report), worker=LEAVES) for report in reports]
        found = [look(self._store.blobs, report) or "" for report in decoded]
        for report in decoded:
            self._store.blobs.forget(LEAVES, [blob.digest for blob in blobs_left(report.result)])
        self.blobs_cpu_s += time.process_time() - cpu_s
        return found

    def _reported(self, reports: list[bytes], damage: list[str]) -> bytes:
        from saflite.contract import wire
        from saflite.contract.work import Report

        pairs = zip(reports, damage, strict=True)
        receipts = [self._books.report(wire.decode(report, Report), self._now, found) for report, found in pairs]
        self._store.commit(self._books.drain())
        refused = [receipt for receipt in receipts if receipt.status != "accepted"]
        assert not refused, refused[0]  # what is refused is done over again: that is not what is measured
        return b"".join(wire.encode(receipt) for receipt in receipts)

    def _timed(self, action: object) -> bytes:
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        answer = action()  # type: ignore[operator]
        self.books_cpu_s += time.process_time() - cpu_s
        self.books_wall_s += time.perf_counter() - wall_s
        return answer  # type: ignore[no-any-return]
