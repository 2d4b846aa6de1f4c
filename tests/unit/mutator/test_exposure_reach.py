"""How flights of `exposure` get to where rules speak: lifted again, out of range, sticks held, what was refused."""

from __future__ import annotations

from collections import Counter

import msgspec
import pytest
from exposure_cases import BOUNDED, HAVE, HINTS, POLICIES, TEMPLATE, case, given, strategy

from saflite.contract.rng import derive
from saflite.contract.target_info import InputInfo
from saflite.contract.test_case import Setting
from saflite.contract.verdict import Transition
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.attention import Attention, read_note
from saflite.mutator.exposure.probes import Probes
from saflite.mutator.exposure.progress import answers
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.strategies.exposure import Strategy


def test_the_state_model_knows_what_comes_down_and_what_lifts_again() -> None:
    model = StateModel()
    assert (model.lift(), model.lands()) == ([], "")
    assert model.comes_down(("LAND", "RTL")) == 0.0
    arm, climb = given("command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0), given("command", "MAV_CMD_NAV_TAKEOFF", 20.0)
    down = (Transition("LOITER", "LAND", 0, -1), Transition("LAND", "LAND standing", -1, 0))
    for _ in range(4):
        model.tell(case(given("mode", "LAND")), down)
    assert model.comes_down(("LOITER",)) == 0.0
    assert model.comes_down(("LOITER", "LAND")) > 0.5
    assert model.lands() == "LAND"
    armed, up = "GUIDED standing disarmed", Transition("GUIDED standing", "GUIDED", 1, 0)
    model.tell(case(arm, climb), (Transition(armed, "GUIDED standing", 0, -1), up))
    mode, *rest = model.lift()
    assert (mode.kind, mode.name) == ("mode", "GUIDED")
    assert rest == [arm, climb]
    model.tell(case(), (Transition("ACRO", "ACRO", -1, -1),), crashed=True)
    assert model.comes_down(("ACRO",)) > 0.0
    assert model.lands() == "LAND"


def test_a_vehicle_that_has_come_down_is_lifted_again_before_the_next_phase() -> None:
    hints: list[str] = ["a-rtl1 start:LOITER@20 in:LAND quiet:5", "upright start:LOITER@20 in:LOITER quiet:5"]
    settings: dict[str, Setting] = {"hints": list(hints), "kept": 0.0, "routed": 0.0, "starts": 0.0, "phases_max": 2}

    def lifted(*, comes_down: bool) -> int:
        searching = Strategy(TEMPLATE, settings, ("a-rtl1", "upright"), describe())
        down = (Transition("LOITER", "LAND", 0, -1), Transition("LAND", "LAND standing", -1, 0))
        for number in range(5 if comes_down else 0):
            flown = case(given("mode", "LAND", at_s=1.0 + number))
            searching.tell([Outcome(test_case=flown, round=0, ending="completed", robustness=None, transitions=down)])
        return sum(
            any(one.name == "MAV_CMD_NAV_TAKEOFF" and one.values[:6] == (0.0,) * 6 for one in test_case.stimuli)
            for test_case in searching.ask(40, derive(1, "ask"))
        )

    assert lifted(comes_down=True) > 8
    assert lifted(comes_down=False) == 0


def test_a_mode_that_only_shows_is_never_ordered_however_often_it_was_seen() -> None:
    shown = tuple(
        one for one in describe().inputs if (one.kind, one.name) not in {("mode", "GUIDED"), ("mode", "LAND")}
    )
    other = msgspec.structs.replace(describe(), name="other", inputs=shown)
    hints: list[str] = ["a-rtl1 start:LOITER@20 quiet:5", "upright start:LOITER@0 quiet:5"]
    settings: dict[str, Setting] = {"hints": list(hints), "kept": 0.0, "routed": 0.0, "starts": 0.0, "phases_max": 4}
    searching = Strategy(TEMPLATE, settings, ("a-rtl1", "upright"), other)
    climb = given("command", "MAV_CMD_NAV_TAKEOFF", 20.0, at_s=9.0)
    armed = given("command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, at_s=8.0)
    for _ in range(5):
        down = (
            Transition("LOITER", "LOITER standing", -1, -1),
            Transition("LOITER", "GUIDED standing disarmed", -1, -1),
        )
        up = (
            Transition("GUIDED standing disarmed", "GUIDED standing", 0, -1),
            Transition("GUIDED standing", "GUIDED", 1, 0),
        )
        flown = Outcome(test_case=case(armed, climb), round=0, ending="completed", robustness=None)
        searching.tell([msgspec.structs.replace(flown, transitions=(*down, *up))])
    drawn = [one for test_case in searching.ask(60, derive(1, "ask")) for one in test_case.stimuli]
    assert {one.name for one in drawn if one.kind == "mode"} <= {one.name for one in shown if one.kind == "mode"}


def test_what_was_refused_is_told_from_what_was_taken_and_from_what_was_never_given() -> None:
    stimuli = [given("stick", "RC1", 1000.0, at_s=float(at_s)) for at_s in (1, 2, 3, 4)]
    steps = (Transition("LOITER", "LOITER", 0, -1), Transition("LOITER", "LOITER", 2, 0))
    flown = Outcome(test_case=case(*stimuli), round=0, ending="crashed", robustness=None, transitions=steps)
    assert answers(flown) == (frozenset({0, 1, 2}), frozenset({0, 2}))
    blind = msgspec.structs.replace(flown, transitions=())
    assert answers(blind) == (frozenset(range(4)), frozenset(range(4)))


def test_a_setting_that_takes_what_it_should_refuse_is_set_again_and_again_and_in_tune_with_another() -> None:
    probes, rng = Probes(HAVE), derive(1, "test")
    assert probes.at_once > 0
    assert probes.lax_values(rng, 1.0) == []
    names = [probes.draw(rng).name for _ in range(60)]
    assert len(set(names)) > 40
    wide, low = given("parameter", "RTL_ALT", 1e6), given("parameter", "LAND_SPEED", -5.0)
    refused = [given("parameter", entry.name, entry.high + 1.0) for entry in BOUNDED[:60] if entry.name[0] != "L"]
    probes.tell(case(*refused), range(len(refused)), ())
    probes.tell(case(wide, low), {0, 1}, {0})
    assert [entry.name for entry in probes.lax] == ["RTL_ALT"]
    values = [value for _ in range(200) for entry, value in probes.lax_values(rng, 1.0)]
    assert min(values) < 0.0 < max(values)
    assert all(not 200.0 <= value <= 8000.0 or value == 0.0 for value in values)
    probes.tell(case(low), {0}, {0})
    pairs = [tuple(value for _, value in probes.lax_values(rng, 1.0)) for _ in range(200)]
    assert 5 < sum(len(pair) == 2 and pair[0] == pair[1] for pair in pairs) < 100


def test_a_lax_setting_that_broke_something_is_set_less_so_that_it_hides_nothing_else() -> None:
    def times(*, ended: bool) -> int:
        probes, rng = Probes(HAVE), derive(1, "test")
        for _ in range(4):
            probes.tell(case(given("parameter", "RTL_ALT", 1e6)), {0}, {0}, ended=ended)
        return sum(len(probes.lax_values(rng, 1.0)) for _ in range(400))

    assert 0 < times(ended=True) < 0.4 * times(ended=False)


def test_a_target_that_takes_most_values_is_hardly_asked() -> None:
    probes = Probes(HAVE)
    asked = [given("parameter", entry.name, entry.high + 1.0) for entry in BOUNDED[:40]]
    probes.tell(case(*asked), range(40), range(40))
    assert probes.at_once == 0
    rng = derive(1, "test")
    assert sum(len(probes.lax_values(rng, 1.0)) for _ in range(100)) < 10


def test_refused_values_are_asked_for_and_a_stick_stays_where_a_rule_wants_it() -> None:
    settings: dict[str, Setting] = {"hints": ["upright in:LOITER quiet:15 holds:RC3=1000"], "kept": 0.0}
    cases = Strategy(TEMPLATE, settings, ("upright",), describe()).ask(40, derive(1, "test"))
    bounds = {entry.name: (entry.low, entry.high) for entry in HAVE.values() if entry.kind == "parameter"}
    outside = [
        one.name
        for test_case in cases
        for one in test_case.stimuli
        if one.kind == "parameter" and not bounds[one.name][0] <= one.values[0] <= bounds[one.name][1]
    ]
    assert len(set(outside)) > 60
    held = 0
    for test_case in cases:
        low = [one.at_s for one in test_case.stimuli if one.name == "RC3" and one.values == (1000.0,)]
        other = [one.at_s for one in test_case.stimuli if one.name == "RC3" and one.values != (1000.0,)]
        held += any(all(not at_s < later < at_s + 14.0 for later in other) for at_s in low)
    assert held > 20


def test_a_search_that_asks_for_no_value_outside_its_range_proposes_none_whatever_was_taken() -> None:
    searching = strategy(beyond=0.0, kept=0.4)
    flown = [case(given("parameter", entry.name, entry.high)) for entry in BOUNDED[:5]]
    for seed in range(4):
        taken = (Transition("LOITER", "LOITER", 0, -1),)
        told = Outcome(test_case=flown[0], round=0, ending="completed", robustness=None, transitions=taken)
        searching.tell([msgspec.structs.replace(told, test_case=one) for one in flown])
        flown = searching.ask(60, derive(seed, "test"))
        outside = [
            f"{one.name} {one.values[0]:g}"
            for test_case in flown
            for one in test_case.stimuli
            if one.kind in ("parameter", "sensor_fault", "stick")
            and not HAVE[one.kind, one.name].low <= one.values[0] <= HAVE[one.kind, one.name].high
        ]
        assert outside == []


def test_a_search_within_ranges_leaves_out_what_has_none_and_drives_no_command_to_extremes() -> None:
    inputs = (
        InputInfo(kind="parameter", name="BOUNDLESS"),
        InputInfo(kind="parameter", name="HALF_BOUNDED", low=0.0),
        InputInfo(kind="parameter", name="CHOSEN", type="choice", choices=(0.0, 3.0)),
        InputInfo(kind="parameter", name="BOUNDED", low=1.0, high=5.0),
        InputInfo(kind="command", name="MAV_CMD_DO_REPOSITION"),
    )
    other = msgspec.structs.replace(describe(), name="other", inputs=inputs)
    words = "upright parameter:BOUNDLESS asks:BOUNDLESS=3 pushes:HALF_BOUNDED=+1 command:MAV_CMD_DO_REPOSITION"
    settings: dict[str, Setting] = {"hints": [words], "beyond": 0.0}
    cases = Strategy(TEMPLATE, settings, ("upright",), other).ask(60, derive(1, "test"))
    drawn = [one for test_case in cases for one in test_case.stimuli]
    assert {one.name for one in drawn if one.kind == "parameter"} == {"CHOSEN", "BOUNDED"}
    assert {one.values for one in drawn if one.name == "CHOSEN"} <= {(0.0,), (3.0,)}
    places = [one.values[4:6] for one in drawn if one.name == "MAV_CMD_DO_REPOSITION" and len(one.values) > 5]
    assert len(places) > 20
    assert all(abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 for lat_deg, lon_deg in places)
    wide = Strategy(TEMPLATE, {**settings, "beyond": 0.2}, ("upright",), other).ask(60, derive(1, "test"))
    assert {one.name for test_case in wide for one in test_case.stimuli} >= {"BOUNDLESS", "HALF_BOUNDED"}


def test_a_search_within_ranges_follows_a_procedure_that_tells_the_value_of_what_has_none() -> None:
    inputs = (InputInfo(kind="parameter", name="HALF_BOUNDED", low=-1.0), InputInfo(kind="mode", name="RTL"))
    other = msgspec.structs.replace(describe(), name="other", inputs=inputs)
    procedures: list[float | int | str | bool] = [
        f"upright air 20; HALF_BOUNDED {value}; RTL; wait 5" for value in ("-1", "~")
    ]
    settings: dict[str, Setting] = {"hints": [], "procedures": procedures, "followed": 1.0, "beyond": 0.0}
    cases = Strategy(TEMPLATE, settings, ("upright",), other).ask(60, derive(1, "test"))
    given = {one.values for test_case in cases for one in test_case.stimuli if one.name == "HALF_BOUNDED"}
    assert given == {(-1.0,)}


def test_settings_are_drawn_oftener_in_the_mode_that_they_are_named_after() -> None:
    def of_return(mode: str) -> int:
        words, rng = Vocabulary(HAVE, Taken()), derive(1, "test")
        return sum(words.draw(rng, "upright", ("parameter",), mode).name.startswith("RTL_") for _ in range(600))

    assert of_return("RTL") > 4 * max(of_return(""), of_return("LOITER")) > 0


def test_a_policy_that_a_lax_setting_bears_on_is_attended_more() -> None:
    attention = Attention(POLICIES)
    assert Counter(attention.rotation(derive(1, "test"), 100, {"a-rtl1"}))["a-rtl1"] == pytest.approx(60, abs=1)
    attention.tell(case(), {"a-rtl1": 1.0})
    assert Counter(attention.rotation(derive(1, "test"), 100, {"a-rtl1"}))["a-rtl1"] < 20

    policies = ("a-rtl1", *(f"p{number}" for number in range(30)))
    settings: dict[str, Setting] = {"hints": list(HINTS[:1]), "kept": 0.0, "routed": 0.0}
    flown = case(*(given("parameter", entry.name, entry.high + 1.0) for entry in BOUNDED))
    place = [one.name for one in flown.stimuli].index("RTL_ALT")

    def aimed(*taken: int) -> int:
        searching = Strategy(TEMPLATE, settings, policies, describe())
        steps = tuple(Transition("LOITER", "LOITER", one, -1) for one in (*taken, -1))
        searching.tell([Outcome(test_case=flown, round=0, ending="completed", robustness=None, transitions=steps)])
        return sum("a-rtl1" in read_note(one.origin.note) for one in searching.ask(40, derive(1, "ask")))

    assert aimed(place) > 1.5 * aimed()
