"""Second flights: which one is flown, what is written of it, and who cannot fly it. On the reference."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
import pytest

from saflite.conformance.flying import fly_once
from saflite.console.cli import main
from saflite.console.commands.fly import TWINS
from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, Flight, FlightRecord, Trace
from saflite.contract.signals import TWIN_SIGNALS
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, Twin, identity
from saflite.flight.autopilots.reference import commands
from saflite.flight.autopilots.reference.autopilot import Autopilot
from saflite.flight.autopilots.reference.commands import MavResult
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.autopilots.reference.modes.circle import Circle
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.flight.autopilots.reference.radio import Radio
from saflite.oracle.judge import judge
from saflite.simulator_worker.afresh import afresh
from saflite.simulator_worker.messages import FlightRequest, flights_in
from saflite.simulator_worker.twins import check_twin, with_twin

REFERENCE = describe()


def case(start: str, *stimuli: Stimulus, twin: Twin, limit_s: float = 20.0) -> TestCase:
    scenario = Scenario(start=StartState(mode=start, altitude_m=20.0), time_limit_s=limit_s)
    return TestCase(target=Target(), scenario=scenario, stimuli=stimuli, rng_seed=3, twin=twin)


def verdict(flown: TestCase, policy: str) -> str:
    record = fly_once(flown)
    flight = Flight(test_case=identity(flown), flight_index=0, ending=record.ending, delivered=record.delivered)
    return judge(flown, flight, record.trace, (policy,)).verdicts[0].outcome


TURN = Stimulus(at_s=2.0, kind="command", name="MAV_CMD_CONDITION_YAW", values=(60.0, 0.0, 1.0, 0.0))
CIRCLE = Stimulus(at_s=1.0, kind="mode", name="CIRCLE")
STICK = Stimulus(at_s=1.0, kind="stick", name="RC4", values=(1900.0,))


def test_a_circle_goes_the_same_wherever_it_begins() -> None:
    assert verdict(case("LOITER", CIRCLE, twin="turned"), "turned-alike") == "held"


def test_a_centre_whose_east_is_mirrored_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    enter = Circle.enter

    def mirrored(self: Circle, previous: object) -> None:
        enter(self, previous)  # type: ignore[arg-type]
        north_m, east_m = self._centre
        self._centre = (north_m, 2.0 * self.board["est_e"] - east_m)

    monkeypatch.setattr(Circle, "enter", mirrored)
    assert verdict(case("LOITER", CIRCLE, twin="turned"), "turned-alike") == "violated"


def test_a_circle_goes_the_same_in_the_mirror() -> None:
    assert verdict(case("LOITER", CIRCLE, twin="mirrored"), "mirrored-alike") == "held"


def test_a_stick_that_acts_to_one_side_only_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    deflection = Radio.deflection
    monkeypatch.setattr(Radio, "deflection", lambda self, channel: max(-0.3, deflection(self, channel)))
    left = Stimulus(at_s=1.0, kind="stick", name="RC1", values=(1100.0,))
    assert verdict(case("LOITER", left, twin="mirrored"), "mirrored-alike") == "violated"


def test_what_was_refused_does_nothing() -> None:
    assert verdict(case("LOITER", TURN, twin="idle"), "refused-does-nothing") == "held"


def test_a_turn_that_is_refused_and_flown_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(ap: Autopilot, numbers: commands.Numbers) -> MavResult:
        ap.yaw_order_rad = 1.0
        return MavResult.FAILED

    number, row = next((number, row) for number, row in commands.command_table().items() if row.name in TURN.name)
    monkeypatch.setitem(commands.command_table(), number, row._replace(handler=refused))
    assert verdict(case("GUIDED", TURN, twin="idle"), "refused-does-nothing") == "violated"


def test_what_waits_for_a_restart_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    source = Stimulus(at_s=1.0, kind="parameter", name="EK2_ALT_SOURCE", values=(2.0,))
    glitch = Stimulus(at_s=4.0, kind="sensor_fault", name="SIM_GPS_GLITCH_Z", values=(12.0,))
    flight = case("LOITER", source, glitch, twin="idle")
    assert verdict(flight, "refused-does-nothing") == "held"
    monkeypatch.setitem(parameter_table(), source.name, parameter_table()[source.name]._replace(reboot=False))
    assert verdict(flight, "refused-does-nothing") == "violated"


PLACE = (0.0, 0.0, 0.0, 0.0, 47.3978, 8.5456, 25.0)
CALLED_BACK = (
    Stimulus(at_s=12.0, kind="mode", name="GUIDED"),
    Stimulus(at_s=13.0, kind="command", name="MAV_CMD_DO_REPOSITION", values=PLACE),
    Stimulus(at_s=20.0, kind="command", name="MAV_CMD_CONDITION_YAW", values=(90.0, 0.0, 1.0, 0.0)),
    Stimulus(at_s=34.0, kind="mode", name="CIRCLE"),
)
REST = {entry.name: entry.default for entry in REFERENCE.inputs if entry.default is not None}


def called_back(*before: Stimulus, twin: Twin = "afresh", limit_s: float = 45.0) -> TestCase:
    return case("LOITER", *before, *CALLED_BACK, twin=twin, limit_s=limit_s)


def test_afresh_nothing_but_settings_is_given_before_it_is_called_back_and_the_sticks_stand_as_they_did() -> None:
    setting = Stimulus(at_s=0.5, kind="parameter", name="CIRCLE_RADIUS", values=(800.0,))
    let_go = msgspec.structs.replace(STICK, at_s=8.0, values=(1500.0,))
    second = afresh(called_back(setting, STICK, let_go), REST)
    assert second is not None
    assert second.test_case.stimuli == (
        setting,
        msgspec.structs.replace(let_go, at_s=CALLED_BACK[0].at_s),
        *CALLED_BACK,
    )
    assert second.from_s == 32.0, "12 s after the last order"


@pytest.mark.parametrize(
    "before",
    [
        (),
        (STICK,),
        (Stimulus(at_s=2.0, kind="sensor_fault", name="SIM_GPS_NUMSATS", values=(3.0,)),),
        (Stimulus(at_s=2.0, kind="command", name="MAV_CMD_DO_CHANGE_SPEED", values=(1.0, 2.0, -1.0)),),
        (Stimulus(at_s=2.0, kind="parameter", name="CIRCLE_RADIUS", values=(800.0,)),),
    ],
)
def test_what_is_still_in_force_or_nothing_at_all_makes_no_flight_afresh(before: tuple[Stimulus, ...]) -> None:
    assert afresh(called_back(*before), REST) is None


def test_without_time_to_come_to_rest_there_is_no_flight_afresh() -> None:
    circle = Stimulus(at_s=1.0, kind="mode", name="CIRCLE")
    soon = (*CALLED_BACK[:3], msgspec.structs.replace(CALLED_BACK[3], at_s=26.0))
    assert afresh(case("LOITER", circle, *soon, twin="afresh", limit_s=45.0), REST) is None
    assert afresh(case("LOITER", circle, *CALLED_BACK[:2], twin="afresh", limit_s=24.0), REST) is None


def test_an_order_that_was_refused_calls_nobody_back() -> None:
    stands = (
        Stimulus(at_s=1.0, kind="mode", name="LAND"),  # from there on it stands disarmed, and its call is refused
        Stimulus(at_s=30.0, kind="mode", name="GUIDED"),
        msgspec.structs.replace(CALLED_BACK[1], at_s=31.0),
    )
    told = case("LOITER", *stands, twin="afresh", limit_s=50.0)
    assert afresh(told, REST) is not None
    assert afresh(told, REST, {2}) is None
    assert verdict(told, "afresh-alike") in ("vacuous", "inconclusive")


def test_who_waits_on_the_ground_must_be_ordered_up_before_it_is_called() -> None:
    """ArduCopter takes an order to a place there and stays: what came before would seem to have lifted the other."""
    ground = Scenario(start=StartState(mode="GUIDED", altitude_m=0.0), time_limit_s=45.0)
    arm, up = (
        Stimulus(at_s=at_s, kind="command", name=name, values=values)
        for at_s, name, values in (
            (12.2, "MAV_CMD_COMPONENT_ARM_DISARM", (1.0,)),
            (12.5, "MAV_CMD_NAV_TAKEOFF", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0)),
        )
    )
    circle = Stimulus(at_s=1.0, kind="mode", name="CIRCLE")
    called = msgspec.structs.replace(called_back(circle), scenario=ground)
    assert afresh(called, REST) is None
    lifted = msgspec.structs.replace(called, stimuli=(circle, CALLED_BACK[0], arm, up, *CALLED_BACK[1:]))
    second = afresh(lifted, REST)
    assert second is not None
    assert {second.test_case.stimuli[at].name for at in second.orders} == {up.name, CALLED_BACK[1].name}


def test_who_was_called_back_flies_on_as_one_that_waited() -> None:
    circle = Stimulus(at_s=1.0, kind="mode", name="CIRCLE")
    assert verdict(called_back(circle), "afresh-alike") == "held"


def test_a_circle_that_remembers_where_it_began_first_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    enter = Circle.enter
    first: dict[object, tuple[float, float]] = {}

    def remembered(self: Circle, previous: object) -> None:
        enter(self, previous)  # type: ignore[arg-type]
        self._centre = first.setdefault(self.ap, self._centre)

    monkeypatch.setattr(Circle, "enter", remembered)
    assert verdict(called_back(Stimulus(at_s=1.0, kind="mode", name="CIRCLE")), "afresh-alike") == "violated"


def test_who_could_not_be_called_in_the_second_flight_is_not_compared() -> None:
    flown = called_back(Stimulus(at_s=1.0, kind="mode", name="CIRCLE"))
    first = fly_once(msgspec.structs.replace(flown, twin=""))
    at = [one.name for one in CALLED_BACK].index("MAV_CMD_DO_REPOSITION")
    denied = first._replace(delivered=(Delivered(index=at, at_s=13.0, answer="denied"),))
    assert with_twin(REFERENCE, flown, first, lambda _: denied) is first
    assert with_twin(REFERENCE, flown, first, lambda _: first) is not first


def test_the_command_line_knows_every_twin() -> None:
    assert tuple(twin for twin in get_args(Twin) if twin) == TWINS


def test_without_a_refusal_there_is_no_second_flight() -> None:
    record = fly_once(case("LOITER", STICK, twin="idle", limit_s=5.0))
    assert record.trace is not None
    assert not set(TWIN_SIGNALS) & set(record.trace.signals)


def test_a_flight_alone_is_the_first_of_two() -> None:
    pair, alone = (fly_once(case("LOITER", STICK, twin=twin, limit_s=5.0)) for twin in ("turned", ""))
    assert pair.trace is not None
    assert alone.trace is not None
    assert {name: data for name, data in pair.trace.signals.items() if name not in TWIN_SIGNALS} == alone.trace.signals


def test_a_test_case_with_a_twin_is_another() -> None:
    assert len({identity(case("LOITER", twin=twin)) for twin in ("", "idle", "turned", "afresh")}) == 4


def test_where_one_ends_sooner_nothing_is_compared() -> None:
    names = ("x_m", "y_m", "altitude_m", "yaw_deg", "mode", "armed")

    def record(samples: int, x_m: float) -> FlightRecord:
        values = {name: np.full(samples, x_m if name == "x_m" else 0.0, dtype="<f4").tobytes() for name in names}
        return FlightRecord("completed", Trace(step_s=0.02, signals=values))

    flown = with_twin(REFERENCE, case("LOITER", twin="turned"), record(10, 0.0), lambda _: record(6, 5.0))
    assert flown.trace is not None
    assert flown.trace.array("twin").tolist() == [1.0] * 6 + [0.0] * 4
    assert flown.trace.array("twin_y_apart_m").tolist() == [-5.0] * 6 + [0.0] * 4
    assert flown.trace.array("twin_heading_apart_deg").tolist() == [-90.0] * 6 + [0.0] * 4


@pytest.mark.parametrize("change", [{"repeats": "statistically"}, {"turns": False}, {"signals": ("x_m",)}])
def test_a_target_that_cannot_says_so(change: dict[str, object]) -> None:
    other = msgspec.structs.replace(REFERENCE, **change)
    with pytest.raises(Refused, match="twin 'turned'"):
        check_twin(other, case("LOITER", twin="turned"))


@pytest.mark.parametrize(("twin", "twice", "flights"), [("", False, 1), ("turned", False, 2), ("idle", True, 3)])
def test_each_of_the_flights_has_the_whole_time(twin: Twin, *, twice: bool, flights: int) -> None:
    request = FlightRequest(number=1, test_case=case("LOITER", twin=twin), deadline_s=1.0, twice=twice)
    assert flights_in(request) == flights


def test_a_heading_is_refused_where_none_is_taken() -> None:
    flown = msgspec.structs.replace(case("LOITER", twin=""), heading_deg=30.0)
    check_twin(REFERENCE, flown)
    with pytest.raises(Refused, match="heading_deg"):
        check_twin(msgspec.structs.replace(REFERENCE, turns=False), flown)


@pytest.mark.parametrize("twin", TWINS)
@pytest.mark.parametrize("stimuli", [(), (TURN,), (CIRCLE, *CALLED_BACK)], ids=len)
def test_a_second_flight_that_is_not_flown_is_told_of(
    twin: Twin, stimuli: tuple[Stimulus, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.json"
    plain = case("LOITER", *stimuli, twin="", limit_s=45.0 if len(stimuli) > 1 else 12.0)
    path.write_bytes(msgspec.json.encode(plain))
    assert main(["fly", str(path), "--twin", twin, "--policy", "turned-alike", "--json"]) in (0, 1, 4)
    said = capsys.readouterr()
    record = fly_once(msgspec.structs.replace(plain, twin=twin))
    assert record.trace is not None
    compared = "twin" in record.trace.signals
    assert compared == {"idle": stimuli == (TURN,), "afresh": len(stimuli) > 1}.get(twin, True)
    assert (f"warning: twin {twin}: no second flight was flown: " in said.err) == (not compared)
    told = json.loads(said.out)["twin"]
    assert (told["asked"], told["compared"], bool(told["why"])) == (twin, compared, not compared)


def test_a_second_flight_that_is_not_flown_is_told_of_beside_a_text(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.json"
    path.write_bytes(msgspec.json.encode(case("LOITER", twin="idle")))
    main(["fly", str(path), "--policy", "turned-alike"])
    assert "twin idle: no second flight was flown: nothing was refused" in capsys.readouterr().err


def test_a_flight_that_asks_for_no_twin_is_told_of_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "case.json"
    path.write_bytes(msgspec.json.encode(case("LOITER", twin="")))
    main(["fly", str(path), "--policy", "turned-alike", "--json"])
    said = capsys.readouterr()
    assert "twin" not in said.err
    assert json.loads(said.out)["twin"] is None
