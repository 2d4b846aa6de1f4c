"""The parts of the strategy `exposure`: hints, attention, learnt relevance, the state model, the corpus, phases."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Origin, Scenario, Setting, StartState, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import Transition
from saflite.contract.work import Outcome, RuleOutcome
from saflite.flight.autopilots.reference.check import check_test_case
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure import numbers
from saflite.mutator.exposure.attention import Attention, note, read_note
from saflite.mutator.exposure.corpus import Corpus
from saflite.mutator.exposure.hints import Hint, read_hints
from saflite.mutator.exposure.phases import Phase, Script, Tempo, shifted
from saflite.mutator.exposure.probes import Probes
from saflite.mutator.exposure.progress import APPLIED, answers, progress
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.operators.inputs import target_inputs
from saflite.mutator.strategies.exposure import Strategy
from saflite.recorder.exports.aerialist import read_case, write_case

HAVE = target_inputs(describe())
BOUNDED = [entry for entry in HAVE.values() if entry.kind == "parameter" and np.isfinite(entry.high)]
START = StartState(mode="LOITER", altitude_m=30.0)
TEMPLATE = TestCase(target=Target(), scenario=Scenario(start=START, time_limit_s=60.0), rng_seed=5)
POLICIES = ("a-rtl1", "a-chute", "upright")
LAST = Stimulus(at_s=60.0, kind="mode", name="LAND")  # the end of a flight
HINTS = ["a-rtl1 start:GUIDED@12 mode:RTL parameter:RTL_ALT", "a-chute start:ALT_HOLD@50 command:MAV_CMD_DO_PARACHUTE"]


def case(*stimuli: Stimulus, text: str = "", parent: str = "", altitude_m: float = 30.0) -> TestCase:
    start = StartState(mode="LOITER", altitude_m=altitude_m)
    scenario = Scenario(start=start, time_limit_s=60.0)
    origin = Origin(strategy="exposure", note=text, parent=parent)
    return msgspec.structs.replace(TEMPLATE, scenario=scenario, stimuli=stimuli, origin=origin)


def given(kind: str, name: str, *values: float, at_s: float = 1.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)  # type: ignore[arg-type]


def strategy(**settings: object) -> Strategy:
    return Strategy(TEMPLATE, {"hints": list(HINTS), **settings}, POLICIES, describe())  # type: ignore[dict-item]


def test_progress_ranks_silent_applied_near_and_violated() -> None:
    far = progress(RuleOutcome("p", "vacuous", 0.3))
    near = progress(RuleOutcome("p", "vacuous", 0.9))
    held = progress(RuleOutcome("p", "held", 1.0, 5.0))
    close = progress(RuleOutcome("p", "held", 1.0, 0.1))
    broken = progress(RuleOutcome("p", "violated", 1.0, -0.1))
    ranked = [far, near, held, close, broken]
    assert None not in ranked
    assert ranked == sorted(ranked, key=lambda value: value or 0.0)
    assert (near or 1.0) < APPLIED < (held or 0.0)
    assert progress(RuleOutcome("p", "inconclusive", 0.0)) is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "p start:LOITER@high",
        "p nonsense",
        "p parameter:NO_SUCH",
        "p kind:RTL_ALT",
        "p quiet:long",
        "p asks:RTL_ALT=high",
        "p asks:NO_SUCH=1",
        "p holds:RC3=far",
        "p holds:RTL_ALT=1000",
    ],
)
def test_a_wrong_hint_is_refused(text: str) -> None:
    with pytest.raises(Refused, match="hints"):
        read_hints([text], ("p",), HAVE)


def test_a_hint_tells_what_a_formula_asks_for() -> None:
    (hint,) = read_hints(["p mission: in:RTL raised:gps quiet:12 asks:FENCE_TYPE=2 holds:RC3=1000"], ("p",), HAVE)
    assert hint.flies_mission
    assert (hint.modes, hint.raised, hint.quiet_s) == (("RTL",), ("gps",), 12.0)
    assert [(entry.name, value) for entry, value in hint.asked] == [("FENCE_TYPE", 2.0)]
    assert [(entry.name, value) for entry, value in hint.held] == [("RC3", 1000.0)]


def test_what_a_formula_asks_for_is_given_and_waited_for() -> None:
    settings: dict[str, Setting] = {"hints": ["upright in:RTL quiet:25 asks:FENCE_TYPE=2"], "kept": 0.0}
    asked = Strategy(TEMPLATE, settings, ("upright",), describe())
    cases = asked.ask(40, derive(1, "test"))
    given_it = [one for one in cases if any(s.name == "FENCE_TYPE" and s.values == (2.0,) for s in one.stimuli)]
    assert len(given_it) > 15
    waits = [max(b.at_s - a.at_s for a, b in pairwise([*one.stimuli, LAST])) for one in cases]
    assert sum(wait >= 25.0 for wait in waits) > 15


def test_the_state_model_knows_what_raised_a_failsafe() -> None:
    model, rng = StateModel(), derive(1, "test")
    fault, mode = given("sensor_fault", "SIM_GPS_DISABLE", 1.0), given("mode", "LAND", at_s=2.0)
    assert model.cause(rng, ("gps",)) is None
    steps = (Transition("LOITER", "LOITER gps", 0, -1), Transition("LOITER gps", "LAND gps radio", 1, 0))
    model.tell(case(fault, mode), steps)
    assert model.cause(rng, ("gps",)) == fault
    assert model.cause(rng, ("battery",)) is None
    assert model.cause(rng, ("radio",)) == fault, "a change of mode raises nothing; what came before it may"
    stick = given("stick", "RC1", 1700.0, at_s=3.0)
    model.tell(case(stick), (Transition("LOITER", "LOITER gps", 0, -1),))
    for _ in range(30):
        model.tell(case(stick), (Transition("LOITER", "LOITER", 0, -1),))
    causes = [model.cause(rng, ("gps",)) for _ in range(100)]
    assert causes.count(fault) > 90, "a stick that is given all the time was there by chance"


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
    settings: dict[str, Setting] = {"hints": list(hints), "kept": 0.0, "routed": 0.0, "starts": 0.0}

    def lifted(*, comes_down: bool) -> int:
        searching = Strategy(TEMPLATE, settings, ("a-rtl1", "upright"), describe())
        down = (Transition("LOITER", "LAND", 0, -1), Transition("LAND", "LAND standing", -1, 0))
        for number in range(5 if comes_down else 0):
            flown = case(given("mode", "LAND", at_s=1.0 + number))
            searching.tell([Outcome(test_case=flown, round=0, ending="completed", robustness=None, transitions=down)])
        climb = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0)
        return sum(
            any(one.name == "MAV_CMD_NAV_TAKEOFF" and one.values == climb for one in test_case.stimuli)
            for test_case in searching.ask(40, derive(1, "ask"))
        )

    assert lifted(comes_down=True) > 20
    assert lifted(comes_down=False) == 0


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


def test_a_campaign_without_a_policy_is_refused() -> None:
    with pytest.raises(Refused, match="at least one policy"):
        Strategy(TEMPLATE, {}, (), describe())


def test_attention_goes_to_every_policy_and_most_to_those_attended_least_and_silent() -> None:
    attention = Attention(POLICIES)
    rng = derive(1, "test")
    assert set(Counter(attention.rotation(rng, 30)).values()) == {10}
    for _ in range(12):
        attention.tell(case(text=note(("a-chute",), "fresh")), {"a-chute": 1.0, "upright": 0.6})
    counts = Counter(attention.rotation(rng, 100))
    assert counts["a-rtl1"] > counts["upright"] > counts["a-chute"] > 0


def test_names_that_bring_a_policy_further_are_drawn_more_often() -> None:
    vocabulary = Vocabulary(HAVE)
    good, bad = given("parameter", "RTL_ALT", 1.0), given("parameter", "WPNAV_SPEED", 1.0)
    for number in range(20):
        vocabulary.tell(case(good if number % 2 else bad), {"a-rtl1": 0.9 if number % 2 else 0.1}, {0}, {0})
    assert vocabulary.relevance("a-rtl1", ("parameter", "RTL_ALT")) > 1.2
    assert vocabulary.relevance("a-rtl1", ("parameter", "WPNAV_SPEED")) < 0.8
    assert vocabulary.relevance("a-chute", ("parameter", "RTL_ALT")) == 1.0
    rng = derive(1, "test")
    drawn = Counter(vocabulary.draw(rng, "a-rtl1", ("parameter",)).name for _ in range(3000))
    assert drawn["RTL_ALT"] > 3 * max(1, drawn["WPNAV_SPEED"])
    assert len(drawn) > 100, "every name of the target can be drawn"


def test_a_command_that_is_always_refused_is_drawn_less_until_it_is_taken_once() -> None:
    vocabulary = Vocabulary(HAVE)
    flown = case(given("command", "MAV_CMD_DO_GRIPPER", 1.0))
    for _ in range(30):
        vocabulary.tell(flown, {"a-rtl1": 0.5}, {0}, set())

    def drawn(rng_seed: int) -> Counter[str]:
        rng = derive(rng_seed, "test")
        return Counter(vocabulary.draw(rng, "a-rtl1", ("command",)).name for _ in range(5000))

    often = 5000 / sum(entry.kind == "command" for entry in HAVE.values())
    assert 0 < drawn(1)["MAV_CMD_DO_GRIPPER"] < 0.4 * often
    vocabulary.tell(flown, {"a-rtl1": 0.5}, {0}, {0})
    assert drawn(2)["MAV_CMD_DO_GRIPPER"] > 0.6 * often


def test_the_state_model_counts_what_is_new_and_knows_the_way_to_a_state() -> None:
    model = StateModel()
    rtl, chute = given("mode", "RTL"), given("command", "MAV_CMD_DO_PARACHUTE", 2.0)
    flown = case(rtl)
    there = (Transition("LOITER", "RTL", 0, -1), Transition("RTL", "RTL standing", -1, 0))
    assert model.tell(flown, there) == 2
    assert model.tell(flown, there) == 0
    assert model.tell(case(rtl, chute), (*there[:1], Transition("RTL", "RTL", 1, 0))) == 1
    scenario, route = model.route("RTL standing") or (None, None)
    assert scenario == flown.scenario
    assert route == [rtl]
    assert model.route("ACRO") is None
    goals = {model.goal(derive(1, number), ("mode", "stick")) for number in range(60)}
    assert {goal[0] for goal in goals if goal} == {"LOITER", "RTL", "RTL standing"}


def test_the_corpus_keeps_the_best_and_what_covers_and_lets_go_of_what_is_changed_in_vain() -> None:
    corpus, rng = Corpus(), derive(1, "test")
    first, second = case(given("mode", "RTL")), case(given("mode", "LAND"))
    corpus.tell(first, {"a-rtl1": 0.4}, 1)
    corpus.tell(second, {"a-rtl1": 0.3}, 0)
    best = corpus.best("a-rtl1")
    assert best is not None
    assert best.identity == identity(first)
    assert corpus.covering(rng) is not None
    for number in range(20):
        corpus.tell(case(given("stick", "RC1", 1500.0 + number), parent=identity(first)), {"a-rtl1": 0.1}, 0)
    corpus.tell(second, {"a-rtl1": 0.3}, 0)
    best = corpus.best("a-rtl1")
    assert best is not None
    assert best.identity == identity(second)
    corpus.tell(case(given("mode", "BRAKE")), {"a-rtl1": 1.0, "upright": 0.6}, 3)
    assert corpus.best("a-rtl1") == best, "what broke a rule is done with"


def test_phases_leave_quiet_and_stay_in_time() -> None:
    tempo = Tempo(0.5, 54.0, (2.0, 20.0), {("stick", "RC1"): 1500.0})
    for number in range(40):
        rng, script = derive(number, "script"), Script(tempo)
        while not script.is_full:
            script.phase(rng, Phase(lambda _: given("stick", "RC1", 1700.0), entry=(given("mode", "RTL"),)))
        stimuli = script.stimuli()
        times = [stimulus.at_s for stimulus in stimuli]
        assert times == sorted(times)
        assert min(times) >= 0.5
        assert times[-1] <= 54.0
        assert max(np.diff([*times, 60.0])) >= 2.0
        later = shifted(stimuli, 0, 10.0, tempo)
        assert all(0.5 <= stimulus.at_s <= 54.0 for stimulus in later)


@pytest.mark.parametrize("kind", ["parameter", "sensor_fault", "command", "stick"])
def test_numbers_reach_small_and_great_sizes_and_nudges_stay_near(kind: str) -> None:
    rng = derive(1, "numbers")
    for entry in [entry for entry in HAVE.values() if entry.kind == kind][:40]:
        drawn = [numbers.draw(rng, entry, 1.0, 0.0) for _ in range(20)]
        assert all(np.isfinite(values).all() for values in drawn)
        if kind == "parameter":
            assert all(entry.low <= values[0] <= entry.high for values in drawn), entry.name
        moved = numbers.nudge(rng, entry, given(kind, entry.name, *drawn[0]))
        assert np.isfinite(moved.values).all()


def test_every_proposal_can_be_flown_and_starts_kinds_and_modes_vary() -> None:
    found = strategy(missions=0.1).ask(200, derive(1, "ask"))
    for one in found:
        check_test_case(one)
    starts = [one.scenario.start for one in found if one.scenario.start]
    assert len({start.mode for start in starts}) >= 8
    assert any(start.altitude_m == 0.0 for start in starts)
    assert sum(one.scenario.mission is not None for one in found) >= 5
    kinds = Counter(stimulus.kind for one in found for stimulus in one.stimuli)
    assert min(kinds.values()) > 0.02 * sum(kinds.values())
    assert len({stimulus.name for one in found for stimulus in one.stimuli}) > 150


@pytest.mark.parametrize(("time_s", "policies"), [(10.0, 1), (60.0, 3), (120.0, 6), (1e12, 60)])
def test_a_fresh_test_case_is_for_as_many_policies_as_its_time_allows(time_s: float, policies: int) -> None:
    names = tuple(f"p{number}" for number in range(100))
    template = msgspec.structs.replace(TEMPLATE, scenario=Scenario(start=START, time_limit_s=time_s))
    made = Strategy(template, {"kept": 0.0, "routed": 0.0}, names, describe()).ask(3, np.random.default_rng(1))
    assert all(0.8 * policies <= len(read_note(one.origin.note)) <= policies for one in made)


def test_every_mission_drawn_can_be_written_beside_the_others_and_read_again(tmp_path: Path) -> None:
    drawn = [case for case in strategy(missions=1.0, kept=0.0).ask(12, derive(3, "test")) if case.scenario.mission]
    assert len({case.scenario.mission.name for case in drawn if case.scenario.mission}) > 6
    files = [write_case(case, tmp_path)[0] for case in drawn]
    assert [identity(read_case(file)) for file in files] == [identity(case) for case in drawn]


def test_told_flights_are_changed_and_routes_to_states_are_taken() -> None:
    searching = strategy(kept=0.5, routed=0.5)
    flown = case(given("mode", "RTL"), given("stick", "RC1", 1700.0, at_s=5.0), text=note(("a-rtl1",), "fresh"))
    searching.tell(
        [
            Outcome(
                test_case=flown,
                round=0,
                ending="completed",
                robustness=1.0,
                rules=(RuleOutcome("a-rtl1", "held", 1.0, 0.2),),
                transitions=(Transition("LOITER", "RTL", 0, -1), Transition("RTL", "RTL", 1, 0)),
            )
        ]
    )
    found = searching.ask(100, derive(1, "ask"))
    children = [one for one in found if one.origin.parent == identity(flown)]
    assert len(children) > 30
    assert all(one.scenario.start == flown.scenario.start for one in children)
    assert any(one.origin.note.startswith("to RTL") for one in found)
    assert Hint("upright") in searching._hints.values()


def test_a_corpus_is_sown_as_it_was_kept_and_texts_that_are_none_are_refused() -> None:
    corpus = Corpus()
    flown = case(given("mode", "RTL"))
    corpus.tell(flown, {"a-rtl1": 0.7}, 2)
    texts = corpus.sown()
    searching = strategy(corpus=texts, kept=1.0)
    assert searching._corpus.sown() == texts
    parents = {one.origin.parent for one in searching.ask(40, derive(1, "ask"))}
    assert parents == {identity(flown)}
    with pytest.raises(Refused, match="strategy setting corpus"):
        strategy(corpus=["{}"])


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
