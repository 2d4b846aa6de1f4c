"""The ArduPilot adapter in flight: against a program that speaks its protocols, and a real one where it is named.

`SAFLITE_ARDUPILOT` names the real binary.
"""

from __future__ import annotations

import csv
import os
import select
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from saflite.conformance.flying import opened
from saflite.contract.errors import Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.standalone import Evidence
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, StimulusKind, Target, TestCase, Wind
from saflite.flight.autopilots.ardupilot.binary import PLACE, Binary, named
from saflite.flight.autopilots.ardupilot.flight import ArduPilotFlight
from saflite.flight.autopilots.ardupilot.listing import ask, known
from saflite.flight.autopilots.external import vehicle as vehicle_module
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.flight.mission import builtin_mission
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import load_target, why_missing
from saflite.simulator_worker.slots import take_slot
from saflite.simulator_worker.targets import ardupilot

pytestmark = pytest.mark.live
HOVER = Scenario(start=StartState(altitude_m=5.0), time_limit_s=4.0)


@pytest.fixture(autouse=True)
def no_process_left() -> Iterator[None]:
    """What a test starts ends with it; tests of other files may have left their helpers."""
    before = set(children(os.getpid()))
    yield
    assert set(children(os.getpid())) <= before


@pytest.fixture
def place() -> Iterator[Place]:
    held = take_slot()
    info = held.info
    yield Place(Path(info.folder), range(info.first_port, info.first_port + info.ports))
    held.release()


@pytest.fixture
def peer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Binary:
    """Return the program that stands in for the autopilot; no file of an earlier listing is known."""
    monkeypatch.setenv("SAFLITE_CACHE", str(tmp_path / "cache"))
    program = tmp_path / "peer"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name("ardupilot_peer.py")} "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return Binary(program, "ab" * 32, "a peer")


@pytest.fixture
def listing(peer: Binary, place: Place) -> Listing:
    return ask(peer, place)


def case(*stimuli: tuple[float, StimulusKind, str, float], scenario: Scenario = HOVER, **parameters: float) -> TestCase:
    return TestCase(
        target=Target(name="ardupilot", parameters=parameters),
        scenario=scenario,
        stimuli=tuple(Stimulus(at_s=at, kind=kind, name=name, values=(value,)) for at, kind, name, value in stimuli),
        rng_seed=3,
    )


def flown(test_case: TestCase, peer: Binary, listing: Listing, place: Place) -> FlightRecord:
    return ArduPilotFlight(test_case, peer, listing, place).run(lambda: False)


def answers(record: FlightRecord) -> list[str]:
    return [one.answer for one in record.delivered or ()]


def test_a_binary_is_asked_once_for_its_parameters(peer: Binary, listing: Listing, place: Place) -> None:
    assert listing.values["RTL_ALT"] == 1500.0
    peer.path.unlink()
    assert ask(peer, place) == known(peer) == listing


def test_it_hovers_and_takes_what_it_is_given(peer: Binary, listing: Listing, place: Place) -> None:
    given = case(
        (0.5, "parameter", "RTL_ALT", 900.0),
        (1.0, "command", "MAV_CMD_DO_GRIPPER", 1.0),
        (1.5, "mode", "LOITER", 0.0),
        (2.0, "stick", "RC1", 1600.0),
        RTL_ALT=1200.0,
    )
    record = flown(given, peer, listing, place)
    assert record.ending == "completed"
    assert answers(record) == ["accepted", "denied", "accepted", "accepted"]
    trace = record.trace
    assert trace is not None
    assert trace.samples == 101
    assert np.abs(trace.array("altitude_m") - 5.0).max() < 0.6
    assert (trace.array("rtl_altitude_set_m")[0], trace.array("rtl_altitude_set_m")[-1]) == (12.0, 9.0)
    assert (trace.array("mode")[0], trace.array("mode")[-1]) == (4.0, 5.0)
    assert trace.array("armed").min() == 1.0
    assert dict(record.artefacts)["console.txt"].startswith(b"Waiting")


def test_flights_repeat_bit_by_bit_also_after_others(peer: Binary, listing: Listing, place: Place) -> None:
    windy = Scenario(start=StartState(altitude_m=5.0), time_limit_s=3.0, wind=Wind(mean_mps=3.0, gust_mps=1.0))
    one = case((0.5, "parameter", "RTL_ALT", 900.0), scenario=windy)
    first = flown(one, peer, listing, place)
    flown(case((0.5, "parameter", "SIM_CUT", 1.0)), peer, listing, place)
    assert list(differences(first, flown(one, peer, listing, place))) == []


def test_landing_ends_the_flight(peer: Binary, listing: Listing, place: Place) -> None:
    land = Scenario(start=StartState(altitude_m=2.0), time_limit_s=30.0)
    record = flown(case((0.2, "mode", "LAND", 0.0), scenario=land), peer, listing, place)
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.duration_s < 25.0
    assert record.trace.array("armed")[-1] == 0.0


def test_falling_is_a_crash_of_the_world(peer: Binary, listing: Listing, place: Place) -> None:
    record = flown(case((0.5, "parameter", "SIM_CUT", 1.0)), peer, listing, place)
    assert record.ending == "crashed"


def test_falling_before_the_start_is_a_crash_where_the_test_case_asked_for_it(
    peer: Binary, listing: Listing, place: Place
) -> None:
    record = flown(case(SIM_CUT=2.0), peer, listing, place)
    assert record.ending == "crashed"
    assert record.trace is not None
    assert record.trace.samples == 1


def test_a_death_is_a_finding_with_its_last_words(peer: Binary, listing: Listing, place: Place) -> None:
    record = flown(case((0.5, "parameter", "SIM_DIE", 1.0)), peer, listing, place)
    assert record.ending == "autopilot_died"
    assert record.message == "the autopilot ended with signal SIGABRT: PANIC: told to at 0x.."
    assert record.trace is not None
    assert 0.44 < record.trace.duration_s <= 0.52
    assert record.delivered is not None
    assert record.delivered[0].at_s == 0.5


def test_silence_is_a_stall(peer: Binary, listing: Listing, place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vehicle_module, "SILENT_MS", 300)
    record = flown(case((0.5, "parameter", "SIM_HANG", 1.0)), peer, listing, place)
    assert record.ending == "wedged"
    assert record.message == "the autopilot hangs"


def test_bring_up_that_fails_is_ours_unless_the_test_case_asked_for_it(
    peer: Binary, listing: Listing, place: Place
) -> None:
    record = flown(case(SIM_NEVER_READY=1.0), peer, listing, place)
    assert record.trace is not None
    assert "start state not reached" in record.trace.messages[0].text
    peer.path.write_text("#!/bin/sh\necho no room; exit 3\n")
    with pytest.raises(Unavailable, match="exit code 3: no room"):
        flown(case(), peer, listing, place)


def test_a_cancelled_flight_leaves_nothing(peer: Binary, listing: Listing, place: Place) -> None:
    with pytest.raises(Unavailable, match="cancelled"):
        ArduPilotFlight(case(), peer, listing, place).run(lambda: True)


def test_it_ends_with_whoever_started_it(tmp_path: Path) -> None:
    starting = f"""
import os, time
from pathlib import Path
from saflite.flight.autopilots.external.process import Process
print(Process(["/bin/sleep", "600"], Path({str(tmp_path)!r}))._process.pid, flush=True)
"""
    pid = int(subprocess.run([sys.executable, "-c", starting], capture_output=True, check=True, text=True).stdout)
    with suppress(ProcessLookupError):  # gone already
        ended = os.pidfd_open(pid)
        assert select.select([ended], [], [], 20.0)[0], "it lives on"


# ---- the real one -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real() -> str:
    lacking = why_missing("ardupilot") if os.environ.get(PLACE) else f"{PLACE} names no binary"
    if lacking:
        pytest.skip(lacking)
    return "ardupilot"


def really_flown(real: str, *cases: TestCase) -> list[FlightRecord]:
    with opened(load_target(real)) as session:
        return [session.fly(one, 300.0, lambda: False) for one in cases]


def test_a_real_one_hovers_changes_modes_and_repeats(real: str) -> None:
    scenario = Scenario(start=StartState(altitude_m=20.0), time_limit_s=20.0)
    one = case((2.0, "mode", "LOITER", 0.0), (5.0, "parameter", "RTL_ALT", 3000.0), scenario=scenario)
    other = case((1.0, "sensor_fault", "SIM_GPS_DISABLE", 1.0), scenario=scenario)
    first, _, again = really_flown(real, one, other, one)
    assert first.ending == "completed"
    assert answers(first) == ["accepted", "accepted"]
    assert first.trace is not None
    assert np.abs(first.trace.array("altitude_m") - 20.0).max() < 1.0
    assert list(differences(first, again)) == []


def test_a_real_one_flies_a_mission_round_a_box(real: str) -> None:
    box = Obstacle(length_m=6, width_m=6, height_m=25, x_m=20, y_m=30)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,), time_limit_s=300.0)
    (record,) = really_flown(real, case(scenario=scenario))
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.array("contact").max() == 0.0


def test_a_real_one_flies_a_finding_without_the_farm(real: str, tmp_path: Path) -> None:
    given = case((1.0, "mode", "LOITER", 0.0), (3.0, "parameter", "RTL_ALT", 900.0), RTL_ALT=1200.0)
    evidence = Evidence("finding.py", "a-loiter1", "LOITER holds", 1.0, 2.0, {}, [])
    (record,) = really_flown(real, given)
    script = tmp_path / "finding.py"
    script.write_text(ardupilot.standalone(given, cast(Any, record), evidence))
    words = [sys.executable, str(script), str(named().path), "--folder", str(tmp_path / "out"), "--speedup", "20"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (log,) = (tmp_path / "out" / "logs").glob("*.BIN")
    assert log.stat().st_size > 100_000
    rows = list(csv.DictReader((tmp_path / "out" / "track.csv").open()))
    assert {row["mode"] for row in rows} == {"4", "5"}
    assert abs(float(rows[-1]["altitude_m"]) - 5.0) < 1.0
