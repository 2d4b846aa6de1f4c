"""The made-up workers of `bench books`, in a process of their own: what the books cost is then theirs alone."""

from __future__ import annotations

import multiprocessing
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from saflite.contract.blobs import BlobRef
    from saflite.contract.work import JudgeResult

FARM = Path(__file__).resolve().parents[2] / "tests" / "farm"
TRACK_POINTS = 180  # one a second
TRACKS = 50  # detours of flights
LEAVES = "all"  # the folder in which all made-up workers leave their blobs


class Services:
    """Does work of every stage in a child process, as the simulated farm does, but remembers no outcome.

    Args:
        run_dir: where the blobs go.
        trace_kib: size of a packed trace.
        placed: blobs are written where the books keep them, not left for them to take.
    """

    def __init__(self, run_dir: Path, trace_kib: int, *, placed: bool) -> None:
        self._end, other = multiprocessing.Pipe()
        self._process = multiprocessing.get_context("fork").Process(
            target=self._run, args=(other, run_dir, trace_kib, placed)
        )
        self._process.start()
        other.close()
        self.cursor = -1  # round up to which outcomes were told

    def do(self, grant: bytes, worker: str) -> list[bytes]:
        """Return the reports, encoded, on what was lent out in an encoded grant."""
        self._end.send((grant, worker))
        reports, self.cursor = self._end.recv()
        return reports  # type: ignore[no-any-return]

    def _run(self, end: Connection, run_dir: Path, trace_kib: int, placed: bool) -> None:
        self._end.close()  # inherited: while it is open here, the end of the other side goes unnoticed
        _serve(end, run_dir, trace_kib, placed)

    def close(self) -> None:
        """End the process."""
        self._end.close()
        self._process.join()


def _serve(end: Connection, run_dir: Path, trace_kib: int, placed: bool) -> None:
    sys.path.insert(0, str(FARM))
    import farm_doubles as doubles

    from saflite.contract import wire
    from saflite.contract.work import Grant, Report
    from saflite.evidence.folder import WorkerFolder

    doubles.padding_kib = trace_kib
    service = _forgetful(doubles)(Placing(run_dir) if placed else WorkerFolder(run_dir, LEAVES))
    while True:
        try:
            data, worker = end.recv()
        except EOFError:
            return
        leases = wire.decode(data, Grant).leases
        reports = [
            Report(worker=worker, lease_id=one.lease_id, epoch=one.epoch, result=service.do(one.work)) for one in leases
        ]
        end.send(([wire.encode(report) for report in reports], service.cursor))


class Placing:
    """Writes blobs where the books keep them: a tenth of the cost of leaving them, where none of that is measured."""

    def __init__(self, run_dir: Path) -> None:
        from saflite.evidence.folder import BlobFolder

        self._store = BlobFolder(run_dir)

    def put(self, data: bytes) -> BlobRef:
        """Write a blob that is not there yet."""
        from saflite.contract.blobs import ref_of

        ref = ref_of(data)
        path = self._store.path(ref.digest)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """Return a blob."""
        return self._store.get(ref)


def _forgetful(doubles: Any) -> type:
    """Return the service of the simulated farm, with a mutator and a scorer whose cost does not grow with the run."""
    from saflite.contract.rng import derive
    from saflite.contract.score import Score, Usage
    from saflite.contract.test_case import identity
    from saflite.contract.work import JudgeResult, MutateResult, MutateWork, Result, ScoreResult, ScoreWork, Work

    class Forgetful(doubles.Service):  # type: ignore[misc]
        told = -1

        @property
        def cursor(self) -> int:
            return self.told

        def do(self, work: Work) -> Result:
            if isinstance(work, MutateWork):
                self.told = max(self.told, work.cursor)
                rng = derive(work.rng_seed, "boxes")
                box = self._mutator._box
                cases = tuple(box(work, index, rng.random(2).tolist()) for index in range(work.count))
                return MutateResult(round=work.round, test_cases=cases)
            if isinstance(work, ScoreWork):
                names = [identity(one) for one in work.test_cases]
                values = [10.0 - 10.0 * doubles.luck(name) for name in names]
                scores = [
                    Score(test_case=name, value=value, model=work.model, scored_by=work.model)
                    for name, value in zip(names, values, strict=True)
                ]
                return ScoreResult(scores=tuple(scores), usage={work.model: Usage(calls=1, tokens_in=len(scores))})
            result = super().do(work)
            return _tracked(result) if isinstance(result, JudgeResult) else result

    return Forgetful


def _tracked(result: JudgeResult) -> JudgeResult:
    """Give a judgement the track of a flight that goes its way with one of many detours, rounded as by the oracle."""
    import farm_doubles as doubles
    import msgspec
    import numpy as np

    from saflite.contract.rng import derive

    name = result.judgement.test_case
    along, way = np.linspace(0.0, 1.0, TRACK_POINTS), int(TRACKS * doubles.luck(f"track {name}"))
    aside_m = (way - TRACKS / 2) * 2.0 * np.sin(np.pi * along)
    own = derive(1, "track", name, result.judgement.flight_index).normal(0.0, 0.2, (TRACK_POINTS, 3))
    places = np.round(np.stack([aside_m, 200.0 * along, np.full(TRACK_POINTS, 10.0)], axis=1) + own, 2).tolist()
    track = tuple((float(second), *place) for second, place in enumerate(places))
    return msgspec.structs.replace(result, judgement=msgspec.structs.replace(result.judgement, track=track))
