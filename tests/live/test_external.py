"""Autopilots in processes of their own, in flight: programs of ours that speak each one's protocols stand in."""

from __future__ import annotations

import re
import select
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from external_flights import Given, StandIn, answers, case, ends, nothing_left, program
from msgspec.structs import replace

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.signals import grid
from saflite.contract.target import Slot
from saflite.contract.test_case import Obstacle, Scenario, StartState, Target, TestCase, Wind
from saflite.flight.autopilots.ardupilot.adapter import ADAPTER as ARDUPILOT
from saflite.flight.autopilots.external import process as process_module
from saflite.flight.autopilots.external import vehicle as vehicle_module
from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.place import Place
from saflite.flight.autopilots.external.process import Process
from saflite.flight.autopilots.external.spinning import Spinning
from saflite.flight.autopilots.px4.adapter import ADAPTER as PX4
from saflite.flight.mission import builtin_mission
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.slots import take_slot
from saflite.simulator_worker.targets._external import ForkingExternalSession

pytestmark = pytest.mark.live
SPINS_S = 0.3


def never() -> bool:
    """Never stop."""
    return False


@pytest.fixture(autouse=True)
def no_process_left() -> Iterator[None]:
    """What a test starts ends with it."""
    with nothing_left():
        yield


@pytest.fixture
def place() -> Iterator[Place]:
    held = take_slot()
    info = held.info
    yield Place(Path(info.folder), range(info.first_port, info.first_port + info.ports))
    held.release()


def standing_in(
    adapter: Adapter, place: Place, folder: Path, monkeypatch: pytest.MonkeyPatch, **settings: str
) -> StandIn:
    """Return the program that stands in for an autopilot; no file of an earlier listing is known."""
    monkeypatch.setenv("SAFLITE_CACHE", str(folder / "cache"))
    binary = program(adapter, folder)
    return StandIn(adapter, binary, adapter.ask(binary, place), place, settings)


@pytest.fixture(
    params=[(ARDUPILOT, {}), (PX4, {}), (PX4, {"physics": "sih"})], ids=["ardupilot", "px4", "px4 on its own physics"]
)
def peer(request: pytest.FixtureRequest, place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    adapter, settings = request.param
    return standing_in(adapter, place, tmp_path, monkeypatch, **settings)


@pytest.fixture
def ardupilot(place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    return standing_in(ARDUPILOT, place, tmp_path, monkeypatch)


@pytest.fixture
def px4(place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    return standing_in(PX4, place, tmp_path, monkeypatch)


def test_a_binary_is_asked_once_for_its_parameters(peer: StandIn) -> None:
    told = {"ardupilot": ("RTL_ALT", 1500.0), "px4": ("GF_ACTION", 2.0)}  # the second is told by its bytes
    name, value = told[peer.name]
    assert peer.listing.values[name] == value
    peer.binary.path.unlink()
    assert peer.adapter.ask(peer.binary, peer.place) == peer.adapter.known(peer.binary) == peer.listing


def test_ardupilot_hovers_and_takes_what_it_is_given(ardupilot: StandIn) -> None:
    record = ardupilot.flown(
        (0.5, "parameter", "RTL_ALT", 900.0),
        (1.0, "command", "MAV_CMD_DO_GRIPPER", 1.0),
        (1.5, "mode", "LOITER", 0.0),
        (2.0, "stick", "RC1", 1600.0),
        RTL_ALT=1200.0,
    )
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


def test_px4_hovers_and_takes_what_it_is_given(px4: StandIn) -> None:
    record = px4.flown(
        (0.2, "parameter", "GF_ACTION", 3.0),
        (0.3, "sensor_fault", "compass_off", 1.0),
        (0.4, "mode", "LOITER", 0.0),
        (0.5, "mode", "ACRO", 0.0),
        (1.0, "stick", "RC1", 1600.0),
        (1.0, "sensor_fault", "baro_noise", 0.1),
        RTL_RETURN_ALT=40.0,
    )
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


@pytest.fixture
def own_px4(place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    return standing_in(PX4, place, tmp_path, monkeypatch, physics="sih")


def test_px4_hovers_on_its_own_physics_and_takes_what_it_is_given(own_px4: StandIn) -> None:
    record = own_px4.flown(
        (0.2, "parameter", "GF_ACTION", 3.0),
        (0.3, "sensor_fault", "baro_offset", 2.0),
        (0.4, "sensor_fault", "gps_satellites", 3.0),
        (0.5, "mode", "LOITER", 0.0),
        (1.0, "stick", "RC1", 1600.0),
        (1.5, "sensor_fault", "radio_loss", 1.0),
        (1.6, "stick", "RC1", 1700.0),
        SIM_GPS_USED=9.0,
    )
    assert record.ending == "completed"
    assert answers(record) == ["accepted"] * 7
    trace = record.trace
    assert trace is not None
    assert trace.samples == 101
    assert np.abs(trace.array("altitude_m") - 5.0).max() < 0.5
    assert np.ptp(trace.array("altitude_m")) > 0.0
    assert trace.array("yaw_deg")[-1] == pytest.approx(np.degrees(0.2), abs=0.5 / grid("yaw_deg"))
    assert (trace.array("fence_action_set")[0], trace.array("fence_action_set")[-1]) == (4.0, 1.0)
    assert trace.array("armed").min() == 1.0
    rc1 = trace.array("rc1_pwm")
    assert (rc1[0], rc1[-1]) == (1500.0, 1600.0)  # then nothing was heard of the pilot


def test_a_box_ends_a_flight_on_physics_that_feels_none(own_px4: StandIn) -> None:
    box = Obstacle(length_m=4.0, width_m=4.0, height_m=9.0, x_m=0.0, y_m=0.0)
    scenario = Scenario(start=StartState(mode="BRAKE", altitude_m=5.0), obstacles=(box,), time_limit_s=4.0)
    target = Target(name="px4", parameters={"SIM_CUT": 0.0})
    record = own_px4.fly(TestCase(target=target, scenario=scenario, rng_seed=3))
    assert record.ending == "crashed"


@pytest.mark.parametrize(("who", "mode"), [("planner", 4.0), ("pilot", 5.0)])
def test_a_mission_is_flown_by_who_stands_beside_it(own_px4: StandIn, who: str, mode: float) -> None:
    """Our planner goes round the box; a pilot, blind, runs into it: this vehicle has no collision prevention."""
    box = Obstacle(length_m=8, width_m=6, height_m=25, x_m=-3, y_m=30)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,), time_limit_s=70.0)
    own_px4 = own_px4._replace(settings={**own_px4.settings, "companion": who})
    record = own_px4.fly(case("px4", scenario=scenario))
    trace = record.trace
    assert trace is not None
    assert mode in trace.array("mode")
    least_m = trace.array("obstacle_distance_m").min()
    if who == "planner":
        assert record.ending == "timed_out"
        assert least_m > 1.0
        assert trace.array("y_m").max() > 36.0  # past the box
    else:
        assert record.ending == "crashed"
        assert 20.0 < trace.array("y_m")[-1] < 30.0


def test_a_build_that_does_not_start_on_its_own_physics_is_told(own_px4: StandIn) -> None:
    assert "SIH_VEHICLE_TYPE" in own_px4.listing.parameters
    program, text = own_px4.binary.path, own_px4.binary.path.read_text()
    program.write_text(text.replace("exec ", 'test "$PX4_SIM_MODEL" = none_iris || exit 3\nexec ', 1))
    listing = own_px4.adapter.ask(own_px4.binary._replace(digest="cd" * 32), own_px4.place)
    assert "SIH_VEHICLE_TYPE" not in listing.parameters
    assert "GF_ACTION" in listing.parameters


def test_flights_repeat_bit_by_bit_also_after_others(ardupilot: StandIn) -> None:
    windy = Scenario(start=StartState(altitude_m=5.0), time_limit_s=3.0, wind=Wind(mean_mps=3.0, gust_mps=1.0))
    one = case("ardupilot", (0.5, "parameter", "RTL_ALT", 900.0), scenario=windy)
    first = ardupilot.fly(one)
    ardupilot.flown((0.5, "parameter", "SIM_CUT", 1.0))
    assert list(differences(first, ardupilot.fly(one))) == []


@pytest.fixture
def forking(ardupilot: StandIn) -> Iterator[ForkingExternalSession]:
    """A session whose flights are forked from their start."""
    folder, ports, _ = ardupilot.place
    slot = Slot(index=0, folder=folder, clock=WallClock(), ports=ports)
    session = ForkingExternalSession(slot, ardupilot.adapter, ardupilot.binary, ardupilot.listing)
    yield session
    session.close()


def unlogged(test_case: TestCase) -> TestCase:
    return replace(test_case, target=replace(test_case.target, settings={"log": "none"}))


STICK: Given = (1.0, "stick", "RC1", 1700.0)


def test_a_flight_forked_from_its_start_is_the_one_from_power_up(forking: ForkingExternalSession) -> None:
    one = unlogged(case("ardupilot", STICK, (2.0, "parameter", "RTL_ALT", 900.0), (2.5, "mode", "LAND", 0.0)))
    other = unlogged(case("ardupilot", (0.0, "stick", "RC1", 1200.0), (0.5, "parameter", "SIM_CUT", 1.0)))
    cold = [forking.fly_cold(each, 60.0, never) for each in (one, other)]
    assert [each.ending for each in cold] == ["completed", "crashed"]
    assert cold[0].trace is not None
    assert cold[0].trace.array("rc1_pwm").max() == 1700.0
    forked = [forking.fly(each, 60.0, never) for each in (one, other, one)]
    for first, again in zip([*cold, cold[0]], forked, strict=True):
        assert list(differences(first, again)) == []
    assert forking._start is not None


def test_a_flight_is_held_on_its_way_and_goes_on_from_there(forking: ForkingExternalSession) -> None:
    one = unlogged(case("ardupilot", STICK, (3.0, "mode", "LAND", 0.0)))
    other = unlogged(case("ardupilot", STICK, (3.5, "stick", "RC1", 1200.0)))
    cold = [forking.fly_cold(each, 60.0, never) for each in (one, other)]
    snapshot = forking.snapshot(one, 2.0, 60.0, never)
    for first, each in zip(cold, (one, other), strict=True):
        assert list(differences(first, forking.fly_from(snapshot, each, 60.0, never))) == []
    forking.drop(snapshot)
    assert list(differences(cold[0], forking.fly_from(snapshot, one, 60.0, never))) == []


def test_a_death_in_a_fork_is_told_as_one_from_power_up(forking: ForkingExternalSession) -> None:
    dies = unlogged(case("ardupilot", (1.0, "parameter", "SIM_DIE", 1.0)))
    cold, forked = forking.fly_cold(dies, 60.0, never), forking.fly(dies, 60.0, never)
    assert "SIGABRT: PANIC: told to" in forked.message
    assert list(differences(cold, forked)) == []
    assert "PANIC" in dict(forked.artefacts)["console.txt"].decode()


def test_what_cannot_be_forked_is_flown_from_power_up(forking: ForkingExternalSession) -> None:
    logged = case("ardupilot", STICK)
    snapshot = forking.snapshot(logged, 2.0, 60.0, never)
    first, again = forking.fly(logged, 60.0, never), forking.fly_from(snapshot, logged, 60.0, never)
    assert list(differences(first, again)) == []
    assert forking._start is None


def test_landing_ends_the_flight(peer: StandIn) -> None:
    modes = {"ardupilot": "GUIDED", "px4": "BRAKE"}
    start = StartState(mode=modes[peer.name], altitude_m=2.5)
    record = peer.flown((0.2, "mode", "LAND", 0.0), start=start, limit_s=40.0)
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.duration_s < 35.0
    assert record.trace.array("armed")[-1] == 0.0


def test_falling_is_a_crash_of_the_world(peer: StandIn) -> None:
    assert peer.flown((0.5, "parameter", "SIM_CUT", 1.0)).ending == "crashed"


def test_falling_before_the_start_is_a_crash_where_the_test_case_asked_for_it(ardupilot: StandIn) -> None:
    record = ardupilot.flown(SIM_CUT=2.0)
    assert record.ending == "crashed"
    assert record.trace is not None
    assert record.trace.samples == 1


def test_a_death_is_a_finding_with_its_last_words(peer: StandIn) -> None:
    record = peer.flown((0.5, "parameter", "SIM_DIE", 1.0))
    assert record.ending == "autopilot_died"
    assert record.message == "the autopilot ended with signal SIGABRT: PANIC: told to at 0x.."
    assert record.trace is not None
    assert 0.4 < record.trace.duration_s <= 0.56
    assert record.delivered is not None
    assert record.delivered[0].at_s == 0.5


def test_silence_is_a_stall(peer: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vehicle_module, "SILENT_MS", 300)
    record = peer.flown((0.5, "parameter", "SIM_HANG", 1.0))
    assert record.ending == "wedged"
    assert record.message == "the autopilot hangs"


@pytest.mark.parametrize("name", ["px4", "own_px4"])
def test_a_thread_that_spins_while_the_others_answer_is_a_stall(
    name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_module, "Spinning", partial(Spinning, spins_s=SPINS_S))
    record = request.getfixturevalue(name).flown((0.5, "parameter", "SIM_SPIN", 1.0), limit_s=3600.0)
    assert record.ending == "wedged"
    assert re.fullmatch(r"the autopilot hangs: its thread \S+ works and never waits", record.message)
    assert record.delivered is not None
    assert record.delivered[0].at_s == 0.5


def test_commands_that_come_now_and_then_are_not_waited_for_each_time(px4: StandIn) -> None:
    clock = WallClock()
    began_s = clock.monotonic_s()
    record = px4.flown((0.5, "parameter", "SIM_SPARSE", 1.0), (4.5, "parameter", "SIM_SPARSE", 0.0), limit_s=6.0)
    assert record.ending == "completed"
    assert clock.monotonic_s() - began_s < 40.0  # 4 s of them were 50 s when each first one missed was waited for


def test_a_thread_that_spins_before_the_start_is_a_stall_where_a_mission_was_given(
    px4: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_module, "Spinning", partial(Spinning, spins_s=SPINS_S))
    scenario = Scenario(mission=builtin_mission("mission2"), time_limit_s=3600.0)
    target = Target(name="px4", parameters={"SIM_SPIN": 1.0})
    assert px4.fly(TestCase(target=target, scenario=scenario)).ending == "wedged"


def test_bring_up_that_fails_is_ours_unless_the_test_case_asked_for_it(peer: StandIn) -> None:
    record = peer.flown(SIM_NEVER_READY=1.0)
    assert record.trace is not None
    assert "start state not reached" in record.trace.messages[0].text
    peer.binary.path.write_text("#!/bin/sh\necho no room; exit 3\n")
    with pytest.raises(Unavailable, match="exit code 3: no room"):
        peer.flown()


def test_a_mission_that_it_does_not_take_is_refused_in_one_line(peer: StandIn) -> None:
    scenario = Scenario(mission=builtin_mission("mission2"), time_limit_s=60.0)
    given = case(peer.name, scenario=scenario)
    told = {"SIM_NO_MISSION": 1.0} if peer.name == "px4" else {}
    with pytest.raises(Refused) as caught:
        peer.fly(replace(given, target=replace(given.target, parameters=told)))
    said = str(caught.value)
    item = {"ardupilot": 1, "px4": 2}[peer.name]  # ArduPilot has home before the items
    assert f"got command not supported (MAV_MISSION_RESULT 3) at item {item}" in said
    assert "mission2" in said
    assert "\n" not in said


def test_a_flight_leaves_nothing(peer: StandIn) -> None:
    peer.flown()
    with pytest.raises(Unavailable, match="cancelled"):
        peer.fly(case(peer.name), cancelled=True)
    assert list(peer.place.folder.iterdir()) == []
    assert list(Path("/tmp").glob(f"px4*-{peer.place.ports[0]}")) == []


def test_it_tells_whether_it_works_or_waits(tmp_path: Path) -> None:
    """Also of what it started."""
    waits, works = (
        Process(["/bin/sh", "-c", f"{what}; :"], tmp_path, environment={})
        for what in ("/bin/sleep 600", "while :; do :; done")
    )
    try:
        assert any(select.select([], [], [], 0.05) and waits.still for _ in range(400))
        assert not all(works.still for _ in range(20))
    finally:
        waits.end()
        works.end()


def test_it_ends_with_whoever_started_it(tmp_path: Path) -> None:
    starting = f"""
import os, time
from pathlib import Path
from saflite.flight.autopilots.external.process import Process
from saflite.flight.autopilots.external.spinning import Spinning
print(Process(["/bin/sleep", "600"], Path({str(tmp_path)!r}), environment={{}})._process.pid, flush=True)
"""
    pid = int(subprocess.run([sys.executable, "-c", starting], capture_output=True, check=True, text=True).stdout)
    assert ends(pid), "it lives on"
