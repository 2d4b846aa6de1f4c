"""The real firmware in lockstep: hover, link loss, rescue, forks that fly on as from power-up, settings, faults."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import msgspec
import pytest

from saflite.conformance.flying import opened
from saflite.contract.config import environment_with
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, FlightRecord, trace_digest
from saflite.contract.memory_faults import is_memory_fault
from saflite.contract.rng import derive
from saflite.contract.standalone import Evidence
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.flight.autopilots.betaflight.configuration import configure
from saflite.flight.autopilots.betaflight.firmware import VARIANTS
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.processes import children
from saflite.simulator_worker.registry import load_target, why_missing
from saflite.simulator_worker.targets._betaflight import BetaflightSession

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(bool(why_missing("betaflight")), reason=f"betaflight: {why_missing('betaflight')}"),
]
DEADLINE_S = 60.0
LOST = Stimulus(at_s=1.0, kind="sensor_fault", name="radio_loss", values=(1.0,))


def case(*stimuli: Stimulus, mode: str = "ANGLE", limit_s: float = 6.0, **parameters: float) -> TestCase:
    return TestCase(
        target=Target(name="betaflight", parameters=parameters),
        scenario=Scenario(start=StartState(mode=mode, altitude_m=20.0), time_limit_s=limit_s),
        stimuli=stimuli,
        rng_seed=1,
    )


def random_case(number: int) -> TestCase:
    """A test case with three inputs of any kind but settings, one in three with a setting."""
    rng = derive(number, "betaflight", "cases")
    inputs = load_target("betaflight").describe().inputs
    live = [one for one in inputs if not one.at_start]
    stimuli = []
    for at_s in sorted(rng.uniform(0.2, 3.5, 3)):
        one = live[int(rng.integers(len(live)))]
        low, high = one.low or 0.0, one.high or 0.0
        values = () if one.low is None else (float(round(rng.uniform(low, high), 3)),)
        stimuli.append(Stimulus(at_s=round(float(at_s), 2), kind=one.kind, name=one.name, values=values))
    gains = {"p_roll": float(rng.integers(30, 60))} if number % 3 == 0 else {}
    return case(*stimuli, mode="ALTHOLD" if number % 2 else "ANGLE", limit_s=4.0, **gains)


@pytest.fixture
def session() -> Iterator[BetaflightSession]:
    with opened(load_target("betaflight")) as found:
        yield cast(BetaflightSession, found)


def fly(session: BetaflightSession, test_case: TestCase) -> FlightRecord:
    return session.fly(test_case, DEADLINE_S, lambda: False)


def last(record: FlightRecord, signal: str) -> float:
    assert record.trace is not None
    return float(record.trace.array(signal)[-1])


def test_it_hovers_and_repeats_bit_by_bit(session: BetaflightSession) -> None:
    for mode in ("ANGLE", "ALTHOLD"):
        first, again = fly(session, case(mode=mode)), fly(session, case(mode=mode))
        assert first.ending == "completed"
        assert first.trace is not None
        assert again.trace is not None
        assert abs(first.trace.array("altitude_m") - 20.0).max() < 1.0
        assert abs(first.trace.array("roll_deg")).max() < 1.0
        assert trace_digest(first.trace) == trace_digest(again.trace)


def test_a_lost_link_cuts_the_motors_and_rescue_brings_it_home(session: BetaflightSession) -> None:
    dropped = fly(session, case(LOST))
    assert dropped.ending == "crashed"
    assert last(dropped, "armed") == 0.0
    assert last(dropped, "failsafe_radio") == 1.0
    rescued = fly(session, case(LOST, limit_s=90.0, failsafe_procedure=2.0))
    assert rescued.ending == "completed"
    assert rescued.trace is not None
    assert rescued.trace.array("box_rescue").max() == 1.0
    assert last(rescued, "armed") == 0.0
    assert last(rescued, "home_distance_m") < 5.0


@pytest.mark.parametrize(("lost_s", "armed"), [(0.0, 0.0), (0.8, 0.0), (3.0, 1.0)])
def test_the_arm_switch_stops_a_rescue_but_one_a_failsafe_took_over(
    lost_s: float, armed: float, session: BetaflightSession
) -> None:
    """What `bf-arm-switch` is silent about: stage 2 begins after 1.5 s and outlasts the loss."""
    rescue = Stimulus(at_s=0.5, kind="mode", name="RESCUE")
    back = msgspec.structs.replace(LOST, at_s=1.0 + lost_s, values=(0.0,))
    off = Stimulus(at_s=6.0, kind="command", name="SWITCH_ARM", values=(0.0,))
    losses = (LOST, back) if lost_s else ()
    record = fly(session, case(rescue, *losses, off, limit_s=7.0, failsafe_procedure=2.0))
    assert last(record, "armed") == armed


def test_a_rescue_switched_off_while_nobody_hears_it_is_no_failsafe(session: BetaflightSession) -> None:
    rescue = Stimulus(at_s=0.5, kind="mode", name="RESCUE")
    off = Stimulus(at_s=2.0, kind="mode", name="ANGLE")
    record = fly(session, case(rescue, LOST, off, limit_s=8.0, failsafe_procedure=1.0, failsafe_delay=50.0))
    assert record.trace is not None
    failsafe, rescued = record.trace.array("failsafe_radio"), record.trace.array("box_rescue")
    assert rescued[200] == 1.0
    assert failsafe[:290].max() == 0.0, "stage 2 begins 5 s after the loss"
    assert failsafe.max() == 1.0


def test_the_failsafe_switch_is_heard(session: BetaflightSession) -> None:
    on = Stimulus(at_s=0.5, kind="command", name="SWITCH_FAILSAFE", values=(1.0,))
    record = fly(session, case(on, limit_s=3.0))
    assert record.trace is not None
    assert record.trace.array("rx_throttle_us")[40] <= 1000.0, "stage 1 closes the throttle"
    assert record.trace.array("failsafe_radio")[80] == 0.0
    assert record.trace.array("failsafe_radio")[120] == 1.0, "stage 2 begins 1.5 s after the switch"


def test_forks_fly_as_from_power_up(session: BetaflightSession) -> None:
    for number in range(12):
        one = random_case(number)
        cold = session.fly_cold(one, DEADLINE_S, lambda: False)
        assert list(differences(cold, fly(session, one))) == [], number


def test_forks_leave_nothing(session: BetaflightSession) -> None:
    fly(session, case(limit_s=0.2))
    files, processes = len(os.listdir("/proc/self/fd")), len(children(os.getpid()))
    for number in range(30):
        fly(session, case(Stimulus(at_s=0.1, kind="stick", name="RC1", values=(1500.0 + number,)), limit_s=0.2))
    assert len(os.listdir("/proc/self/fd")) == files
    assert len(children(os.getpid())) == processes


def test_settings_act_and_bad_ones_are_told(session: BetaflightSession) -> None:
    swinging = Stimulus(at_s=0.0, kind="parameter", name="ap_altitude_i", values=(200.0,))
    assert last(fly(session, case(limit_s=0.2)), "height_tune_usual") == 1.0
    assert last(fly(session, case(swinging, limit_s=0.2)), "height_tune_usual") == 0.0
    assert last(fly(session, case(limit_s=0.2, level_race_mode=1.0)), "race_mode_set") == 1.0
    early = Stimulus(at_s=0.0, kind="parameter", name="angle_limit", values=(30.0,))
    lean = Stimulus(at_s=1.0, kind="stick", name="RC1", values=(2000.0,))
    record = fly(session, case(early, lean, limit_s=2.5))
    assert record.trace is not None
    assert 20.0 < record.trace.array("roll_deg").max() < 40.0
    assert record.delivered is not None
    assert [one.answer for one in record.delivered] == ["accepted", "accepted"]
    beyond = Stimulus(at_s=0.0, kind="parameter", name="angle_limit", values=(900.0,))
    denied = fly(session, case(beyond, limit_s=0.5))
    assert denied.delivered is not None
    assert denied.delivered[0].answer == "denied"
    with pytest.raises(Refused, match="angle_limit"):
        fly(session, case(angle_limit=900.0))
    with pytest.raises(Refused, match="no_such"):
        fly(session, case(no_such=1.0))


def test_messages_are_answered(session: BetaflightSession) -> None:
    ask = Stimulus(at_s=0.5, kind="command", name="MSP", values=(1.0,))  # the API's version
    unknown = Stimulus(at_s=1.0, kind="command", name="MSP", values=(251.0, 1.0, 2.0))
    noise = Stimulus(at_s=1.5, kind="command", name="SERIAL_BYTES", values=(36.0, 77.0, 60.0, 200.0))
    record = fly(session, case(ask, unknown, noise, limit_s=2.5))
    assert record.delivered is not None
    assert [one.answer for one in record.delivered] == ["accepted", "denied", "unanswered"]


def test_a_gyro_that_sticks_and_a_motor_that_fails_end_in_a_crash(session: BetaflightSession) -> None:
    for name, size in (("gyro_stuck", 1.0), ("motor_failed", 2.0)):
        fault = Stimulus(at_s=0.5, kind="sensor_fault", name=name, values=(size,))
        push = Stimulus(at_s=1.0, kind="stick", name="RC1", values=(1800.0,))
        assert fly(session, case(fault, push, limit_s=20.0)).ending == "crashed", name


def test_a_finding_reproduces_without_the_farm(session: BetaflightSession, tmp_path: Path) -> None:
    broken = case(LOST, mode="ALTHOLD", limit_s=4.0, failsafe_procedure=1.0)
    record = fly(session, broken)
    assert record.trace is not None
    flight = Flight(
        test_case=identity(broken), flight_index=0, ending=record.ending, trace_digest=trace_digest(record.trace)
    )
    evidence = Evidence("it.py", "bf-rule", "Motors go on", 1.0, 3.5, {"values": "all inside"}, ("at 1 s: link lost",))
    text = load_target("betaflight").standalone(broken, flight, evidence)["it.py"]  # type: ignore[attr-defined]
    done = _replayed(tmp_path / "it.py", text)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "VIOLATION SEEN" in done.stdout
    assert "FAILSAFE" in done.stdout
    assert "set failsafe_procedure = DROP" in text
    other = _replayed(
        tmp_path / "other.py", text.replace("failsafe_procedure = DROP", "failsafe_procedure = AUTO-LAND")
    )
    assert other.returncode == 1, "another setting must not show it"
    assert "violation not seen" in other.stdout
    junk = tmp_path / "junk"
    for content, mode, words in ((b"x", 0o755, "does not run"), (b"#!/bin/sh\n", 0o755, "not start"), (b"", 0o644, "")):
        junk.write_bytes(content)
        junk.chmod(mode)
        told = _replayed(tmp_path / "it.py", text, junk)
        assert told.returncode == 1
        assert words in told.stderr
        assert told.stderr.count("\n") == 1
    told = _replayed(tmp_path / "it.py", text, PATH=str(tmp_path))
    assert told.returncode == 1
    assert told.stderr.startswith("gcc is needed")
    unlike = msgspec.structs.replace(flight, trace_digest="0" * 64)
    with pytest.raises(Refused, match="export it with the binary"):
        load_target("betaflight").standalone(broken, unlike, evidence)  # type: ignore[attr-defined]


def _replayed(
    script: Path, text: str, binary: Path = VARIANTS["gps"].binary, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run a script as somebody without our package does."""
    script.write_text(text)
    command, where = [sys.executable, "-I", "-S", str(script), str(binary)], environment_with(**variables)
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=script.parent, env=where)


def test_a_runaway_take_off_is_told_and_so_are_settings_that_were_lost(session: BetaflightSession) -> None:
    ground = Scenario(start=StartState(mode="ANGLE", altitude_m=0.0, armed=False), time_limit_s=5.0)
    stimuli = (
        Stimulus(at_s=0.0, kind="stick", name="RC3", values=(1000.0,)),
        Stimulus(at_s=0.1, kind="sensor_fault", name="motor_swap", values=(13.0,)),
        Stimulus(at_s=0.5, kind="command", name="SWITCH_ARM", values=(1.0,)),
        Stimulus(at_s=2.0, kind="stick", name="RC3", values=(1550.0,)),
    )
    record = fly(session, msgspec.structs.replace(case(*stimuli), scenario=ground))
    assert record.trace is not None
    assert record.trace.array("armed").max() == 1.0
    assert last(record, "runaway_stopped") == 1.0
    assert last(record, "armed") == 0.0
    assert last(fly(session, case(limit_s=0.2, failsafe_delay=7.0)), "settings_lost") == 0.0
    mended = case(limit_s=0.2, gyro_notch1_hz=100.0, gyro_notch1_cutoff=200.0)
    assert last(fly(session, mended), "settings_lost") >= 1.0


def test_a_users_own_memory_is_taken_and_a_damaged_one_told(session: BetaflightSession, tmp_path: Path) -> None:
    whole = configure(VARIANTS["gps"], {"failsafe_delay": 33.0}, tmp_path).eeprom
    file = tmp_path / "mine.bin"

    def own(content: bytes) -> FlightRecord:
        file.write_bytes(content)
        base = case(limit_s=0.2)
        target = msgspec.structs.replace(base.target, settings={"eeprom": str(file)})
        return fly(session, msgspec.structs.replace(base, target=target))

    assert own(whole).ending == "completed"
    for damaged in (whole[:300] + bytes([whole[300] ^ 255]) + whole[301:], bytes(len(whole)), whole[:1000], b""):
        with pytest.raises(Refused, match="make it anew") as told:
            own(damaged)
        assert "\n" not in str(told.value)
    file.unlink()
    with pytest.raises(Refused, match="can be read"):
        fly(session, msgspec.structs.replace(case(), target=Target(name="betaflight", settings={"eeprom": str(file)})))


def test_settings_act_in_flight_where_the_firmware_takes_them(session: BetaflightSession) -> None:
    def given(at_s: float, name: str, value: float) -> Stimulus:
        return Stimulus(at_s=at_s, kind="parameter", name=name, values=(value,))

    changes = given(0.5, "failsafe_procedure", 2.0), given(0.5, "failsafe_throttle", 1300.0), given(0.6, "p_roll", 40.0)
    late = given(0.7, "failsafe_delay", 50.0), given(0.8, "p_roll", 999.0)
    lost = msgspec.structs.replace(LOST, at_s=1.5)
    record = fly(session, case(*changes, *late, lost, limit_s=12.0, failsafe_procedure=1.0))
    assert record.delivered is not None
    assert [one.answer for one in record.delivered] == ["accepted"] * 3 + ["denied"] * 2 + ["accepted"]
    assert last(record, "failsafe_procedure") == 2.0
    assert record.ending == "completed", "it would drop, as it was set before"
    assert record.trace is not None
    assert record.trace.array("box_rescue").max() == 1.0
    shaky = fly(session, case(given(0.5, "p_roll", 250.0), given(0.5, "d_roll", 0.0), limit_s=4.0))
    assert shaky.trace is not None
    assert abs(shaky.trace.array("roll_rate_dps")[100:]).max() > 20.0


def test_a_death_on_the_sanitized_build_is_flown_on_the_plain_one(session: BetaflightSession) -> None:
    place = "AddressSanitizer: heap-use-after-free in inner < middle < outer"
    died = FlightRecord("autopilot_died", None, f"the firmware died: {place}")
    told = session._beside_plain(died, case(limit_s=0.2), lambda: False)
    assert told.message == f"the firmware died (the plain build: completed): {place}"
    assert is_memory_fault(told.ending, told.message)
    dropped = session._beside_plain(died, case(LOST), lambda: False)
    assert dropped.message == f"the firmware died (the plain build: crashed): {place}"
