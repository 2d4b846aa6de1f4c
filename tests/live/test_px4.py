"""The PX4 adapter in flight: against a program that speaks its protocols, and a real one where it is named.

`SAFLITE_PX4` names the real binary: `bin/px4` in its build folder.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from saflite.conformance.flying import opened
from saflite.contract.errors import Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, StimulusKind, Target, TestCase, Wind
from saflite.flight.autopilots.external import vehicle as vehicle_module
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.flight.autopilots.px4.binary import PLACE, START_UP, Binary
from saflite.flight.autopilots.px4.flight import Px4Flight
from saflite.flight.autopilots.px4.listing import ask, known
from saflite.flight.mission import builtin_mission
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import load_target, why_missing
from saflite.simulator_worker.slots import take_slot

pytestmark = pytest.mark.live
HOVER = Scenario(start=StartState(mode="BRAKE", altitude_m=5.0), time_limit_s=4.0)


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
    program = tmp_path / "build" / "bin" / "px4"
    program.parent.mkdir(parents=True)
    (tmp_path / "build" / "etc" / START_UP).mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {Path(__file__).with_name("px4_peer.py")} "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return Binary(program, "ab" * 32, "a peer")


@pytest.fixture
def listing(peer: Binary, place: Place) -> Listing:
    return ask(peer, place)


def case(*stimuli: tuple[float, StimulusKind, str, float], scenario: Scenario = HOVER, **parameters: float) -> TestCase:
    return TestCase(
        target=Target(name="px4", parameters=parameters),
        scenario=scenario,
        stimuli=tuple(Stimulus(at_s=at, kind=kind, name=name, values=(value,)) for at, kind, name, value in stimuli),
        rng_seed=3,
    )


def flown(test_case: TestCase, peer: Binary, listing: Listing, place: Place) -> FlightRecord:
    return Px4Flight(test_case, peer, listing, place).run(lambda: False)


def answers(record: FlightRecord) -> list[str]:
    return [one.answer for one in record.delivered or ()]


def test_a_binary_is_asked_once_for_its_parameters(peer: Binary, listing: Listing, place: Place) -> None:
    assert listing.values["GF_ACTION"] == 2.0  # told by its bytes
    peer.path.unlink()
    assert ask(peer, place) == known(peer) == listing


def test_it_hovers_and_takes_what_it_is_given(peer: Binary, listing: Listing, place: Place) -> None:
    given = case(
        (0.2, "parameter", "GF_ACTION", 3.0),
        (0.3, "sensor_fault", "compass_off", 1.0),
        (0.4, "mode", "LOITER", 0.0),
        (0.5, "mode", "ACRO", 0.0),
        (1.0, "stick", "RC1", 1600.0),
        (1.0, "sensor_fault", "baro_noise", 0.1),
        RTL_RETURN_ALT=40.0,
    )
    record = flown(given, peer, listing, place)
    assert record.ending == "completed"
    assert answers(record) == ["accepted", "denied", "accepted", "denied", "accepted", "accepted"]
    assert record.delivered is not None
    assert record.delivered[3].message == "acknowledged, but without effect"
    trace = record.trace
    assert trace is not None
    assert np.abs(trace.array("altitude_m") - 5.0).max() < 1.5
    assert trace.array("rtl_altitude_set_m")[0] == 40.0
    assert (trace.array("fence_action_set")[0], trace.array("fence_action_set")[-1]) == (4.0, 1.0)
    assert (trace.array("rc1_pwm")[0], trace.array("rc1_pwm")[-1]) == (1500.0, 1600.0)
    assert trace.array("armed").min() == 1.0


def test_landing_ends_the_flight(peer: Binary, listing: Listing, place: Place) -> None:
    land = Scenario(start=StartState(mode="BRAKE", altitude_m=3.0), time_limit_s=40.0, wind=Wind(mean_mps=1.0))
    record = flown(case((0.2, "mode", "LAND", 0.0), scenario=land), peer, listing, place)
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.duration_s < 35.0
    assert record.trace.array("armed")[-1] == 0.0


def test_falling_is_a_crash_of_the_world(peer: Binary, listing: Listing, place: Place) -> None:
    record = flown(case((0.5, "parameter", "SIM_CUT", 1.0)), peer, listing, place)
    assert record.ending == "crashed"


def test_a_death_is_a_finding_with_its_last_words(peer: Binary, listing: Listing, place: Place) -> None:
    record = flown(case((0.5, "parameter", "SIM_DIE", 1.0)), peer, listing, place)
    assert record.ending == "autopilot_died"
    assert record.message == "the autopilot ended with signal SIGABRT: PANIC: told to at 0x.."
    assert record.trace is not None
    assert 0.4 < record.trace.duration_s <= 0.56


def test_silence_is_a_stall(peer: Binary, listing: Listing, place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vehicle_module, "SILENT_MS", 300)
    record = flown(case((0.5, "parameter", "SIM_HANG", 1.0)), peer, listing, place)
    assert record.ending == "wedged"


def test_bring_up_that_fails_is_ours_unless_the_test_case_asked_for_it(
    peer: Binary, listing: Listing, place: Place
) -> None:
    record = flown(case(SIM_NEVER_READY=1.0), peer, listing, place)
    assert record.trace is not None
    assert "start state not reached" in record.trace.messages[0].text
    peer.path.write_text("#!/bin/sh\necho no room; exit 3\n")
    with pytest.raises(Unavailable, match="exit code 3: no room"):
        flown(case(), peer, listing, place)


def test_a_flight_leaves_no_file(peer: Binary, listing: Listing, place: Place) -> None:
    flown(case(), peer, listing, place)
    with pytest.raises(Unavailable, match="cancelled"):
        Px4Flight(case(), peer, listing, place).run(lambda: True)
    assert list(place.folder.iterdir()) == []
    assert list(Path("/tmp").glob(f"px4*-{place.ports[0]}")) == []


# ---- the real one -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real() -> str:
    lacking = why_missing("px4") if os.environ.get(PLACE) else f"{PLACE} names no binary"
    if lacking:
        pytest.skip(lacking)
    return "px4"


def really_flown(real: str, *cases: TestCase) -> list[FlightRecord]:
    with opened(load_target(real)) as session:
        return [session.fly(one, 300.0, lambda: False) for one in cases]


def test_a_real_one_hovers_and_changes_modes(real: str) -> None:
    scenario = Scenario(start=StartState(mode="LOITER", altitude_m=20.0), time_limit_s=20.0)
    one = case((2.0, "mode", "ALT_HOLD", 0.0), (5.0, "parameter", "RTL_RETURN_ALT", 30.0), scenario=scenario)
    (record,) = really_flown(real, one)
    assert record.ending == "completed"
    assert answers(record) == ["accepted", "accepted"]
    assert record.trace is not None
    assert np.abs(record.trace.array("altitude_m") - 20.0).max() < 3.0
    assert record.trace.array("rtl_altitude_set_m")[-1] == 30.0
    assert set(record.trace.array("mode")) == {2.0, 5.0}


def test_a_real_one_sees_faults(real: str) -> None:
    scenario = Scenario(start=StartState(mode="LOITER", altitude_m=20.0), time_limit_s=20.0)
    lost, silent = (case((2.0, "sensor_fault", name, 1.0), scenario=scenario) for name in ("gps_off", "radio_loss"))
    blind, deaf = really_flown(real, lost, silent)
    assert answers(blind) == ["accepted"]
    assert blind.trace is not None
    assert deaf.trace is not None
    assert blind.trace.array("gps_ok")[-1] == 0.0
    assert set(blind.trace.array("mode")) != {5.0}
    assert deaf.trace.array("mode")[-1] in (6.0, 9.0)  # returns, then lands


def test_a_real_one_flies_a_mission(real: str) -> None:
    box = Obstacle(length_m=6, width_m=6, height_m=25, x_m=200, y_m=300)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,), time_limit_s=300.0)
    (record,) = really_flown(real, case(scenario=scenario))
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.array("mission_item").max() >= 2.0
