"""The recording of any flight of a run, on demand: flown again, held against its record bit by bit, written down."""

from __future__ import annotations

from pathlib import Path

from saflite.console.io import outputs
from saflite.console.operations import judging
from saflite.console.run_data.rows import FlightRow
from saflite.console.run_data.run_folder import open_run
from saflite.contract.errors import Refused
from saflite.contract.flight import UNTOLD
from saflite.contract.verdict import Judgement
from saflite.contract.work import RecordWork

WALL_LIMIT_S = 120.0


def record_again(run_dir: Path, wanted: str, folder: Path, wall_limit_s: float) -> Path:
    """Write the recording of a test case (its identity or the start of it) to `folder`; returns the file.

    Recorded is the flight that shows its violation, or its first one.

    Raises:
        Refused: the run holds no such test case, it was not judged, or flies differently on the software here.
        Unavailable: its target cannot be flown here, the simulator does not come up, or the disk is full.
    """
    with open_run(run_dir) as run:
        rows = [row for row in run.flights() if row.test_case.startswith(wanted) and row.purpose not in UNTOLD]
        shown = {(one.test_case, one.flight_index): one for one in run.violations()}
        row = next((row for row in rows if (row.test_case, row.flight_index) in shown), rows[0] if rows else None)
        if row is None:
            fix = "see `saflite export RUN --format csv`"
            raise Refused("test case", where=str(run_dir), expected="one flown in this run", got=repr(wanted), fix=fix)
        test_case, judgement = run.test_case(row.test_case), run.judgement(row.test_case, row.flight_index)
        violation, texts = shown.get((row.test_case, row.flight_index)), run.campaign.policy_texts
    if judgement is None:
        raise Refused("test case", where=str(run_dir), expected="one that was judged", got=row.ending)
    judging.check_flies_here(test_case.target.name)
    simulator = judging.OwnSimulator()
    try:
        flown = simulator.fly(test_case, wall_limit_s, row.flight_index, row.flight_index)
    finally:
        simulator.close()
    _check_equal(row, flown.flight.trace_digest, run_dir)
    work = RecordWork(
        test_case=test_case, flight=flown.flight, judgement=judgement, violation=violation, policy_texts=texts
    )
    return _written(work, flown.packed, folder, judgement)


def _check_equal(row: FlightRow, trace_digest: str, run_dir: Path) -> None:
    if trace_digest != row.trace_digest:
        raise Refused(
            f"flight of {row.test_case}",
            where=str(run_dir),
            expected=f"the trace recorded, {row.trace_digest[:16] or 'none'}",
            got=trace_digest[:16] or "none",
            fix="fly it with the software that the run was made with",
        )


def _written(work: RecordWork, packed: bytes, folder: Path, judgement: Judgement) -> Path:
    from saflite.recorder import mcap
    from saflite.runtime.clock import WallClock

    path = folder / f"{judgement.test_case}-{judgement.flight_index}.mcap"
    outputs.write(path, mcap.write(work, packed, WallClock().unix_s() - work.flight.simulated_s), force=True)
    return path
