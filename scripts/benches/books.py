"""What the books cost: results per second and their share of a core with every commit on disk, rebuilding, memory.

The services are the scripted ones of the simulated farm (`tests/farm`); every message is encoded and decoded, traces
are those of real flights in size (`--trace-kib`), each result is committed on its own or in batches of `--together`.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
WORKERS = ("a", "b")


def main(argv: list[str]) -> int:
    """Measure and print; 0."""
    parser = argparse.ArgumentParser(prog="scripts/bench books", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=2000, help="budget of the campaign")
    parser.add_argument("--together", type=int, default=4, help="leases taken and results committed together")
    parser.add_argument("--trace-kib", type=int, default=100, help="size of a packed trace")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(argv)
    sys.path.insert(0, str(HERE.parents[1] / "tests" / "farm"))
    with tempfile.TemporaryDirectory() as folder:
        figures = _measure(Path(folder) / "run", options)
    if options.json:
        print(json.dumps(figures))
    else:
        for name, value in figures.items():
            print(f"{name:28} {value:,.2f}" if isinstance(value, float) else f"{name:28} {value:,}")
    return 0


def _measure(run_dir: Path, options: argparse.Namespace) -> dict[str, float | int]:
    import farm_doubles as doubles

    from saflite.campaign.storage.store import Store

    doubles.padding_kib, doubles.track_points = options.trace_kib, 250
    search: dict[str, Any] = {"candidates_per_round": 40, "flights_per_round": 8, "lag": 3}
    store = Store.create(
        run_dir, doubles.campaign(options.flights, batch=10, **search), doubles.TEMPLATE, doubles.TARGET
    )
    drive = _Drive(store, options.together)
    drive.run()
    database_mb = (run_dir / "books.sqlite").stat().st_size / 1e6
    store.close()
    started_s = time.perf_counter()
    store = Store.open(run_dir)
    opened_s = time.perf_counter() - started_s
    books = store.rebuild()
    rebuilt_s = time.perf_counter() - started_s
    status = books.status(0.0)
    store.close()
    return {
        "flights": status.flights,
        "results": drive.results,
        "results_per_cpu_s": drive.results / drive.books_cpu_s,
        "core_share_at_500_per_s": 500.0 * drive.books_cpu_s / drive.results,
        "results_per_wall_s": drive.results / drive.books_wall_s,
        "open_and_check_s": opened_s,
        "open_and_rebuild_s": rebuilt_s,
        "database_mb": database_mb,
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


class _Drive:
    """Runs a campaign; only the time inside the books, their messages and their store is counted."""

    def __init__(self, store: object, together: int) -> None:
        import farm_doubles as doubles

        from saflite.contract.join import Join
        from saflite.contract.topics import PROTOCOL, STAGES

        self._store, self._together = store, together
        self._books = store.rebuild()  # type: ignore[attr-defined]
        self._service = doubles.Service()
        self._now = 0.0
        self.results, self.books_cpu_s, self.books_wall_s = 0, 0.0, 0.0
        self._books.begin(0.0, 1.7e9)
        for stage in STAGES:
            for worker in WORKERS:
                self._books.join(Join(protocol=PROTOCOL, worker=worker, stage=stage), 0.0)

    def run(self) -> None:
        """Run to the end."""
        from saflite.contract.topics import STAGES

        while not self._books.ended:
            for stage in STAGES:
                for worker in WORKERS:
                    self._turn(stage, worker)
            self._now += 0.05
            self._timed(lambda: self._books.tick(self._now))

    def _turn(self, stage: str, worker: str) -> None:
        from saflite.contract import wire
        from saflite.contract.work import Ask, Grant, Report

        cursor = self._service.cursor_of(stage)  # type: ignore[arg-type]
        ask = wire.encode(Ask(worker=worker, stage=stage, leases_max=self._together, cursor=cursor))  # type: ignore[arg-type]
        grant = wire.decode(self._timed(lambda: self._asked(ask)), Grant)
        reports = [
            wire.encode(
                Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=self._service.do(lease.work))
            )
            for lease in grant.leases
        ]
        if reports:
            self._timed(lambda: self._reported(reports))
            self.results += len(reports)

    def _asked(self, ask: bytes) -> bytes:
        from saflite.contract import wire
        from saflite.contract.work import Ask

        grant = self._books.ask(wire.decode(ask, Ask), self._now)
        self._store.commit(self._books.drain())  # type: ignore[attr-defined]
        return wire.encode(grant)

    def _reported(self, reports: list[bytes]) -> bytes:
        from saflite.contract import wire
        from saflite.contract.work import Report

        receipts = [self._books.report(wire.decode(report, Report), self._now) for report in reports]
        self._store.commit(self._books.drain())  # type: ignore[attr-defined]
        return b"".join(wire.encode(receipt) for receipt in receipts)

    def _timed(self, action: object) -> bytes:
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        answer = action()  # type: ignore[operator]
        self.books_cpu_s += time.process_time() - cpu_s
        self.books_wall_s += time.perf_counter() - wall_s
        return answer  # type: ignore[no-any-return]
