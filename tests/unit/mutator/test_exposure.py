"""The parts of the strategy `exposure`: hints, attention, learnt relevance, the state model, the corpus, phases."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from exposure_cases import HAVE, LAST, POLICIES, START, TEMPLATE, case, given, strategy

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Scenario, Setting, identity
from saflite.contract.verdict import Transition
from saflite.contract.work import Outcome, RuleOutcome
from saflite.flight.autopilots.reference.check import check_test_case
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure import numbers
from saflite.mutator.exposure.attention import Attention, note, read_note
from saflite.mutator.exposure.corpus import Corpus
from saflite.mutator.exposure.hints import Hint, read_hints
from saflite.mutator.exposure.phases import Phase, Script, Tempo, shifted
from saflite.mutator.exposure.progress import APPLIED, progress
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.strategies.exposure import Strategy
from saflite.recorder.exports.aerialist import read_case, write_case


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
    vocabulary = Vocabulary(HAVE, Taken())
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
    vocabulary = Vocabulary(HAVE, Taken())
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


@pytest.mark.parametrize(("time_s", "policies"), [(10.0, 1), (60.0, 3), (120.0, 6), (1e12, 20)])
def test_a_fresh_test_case_is_for_as_many_policies_as_its_time_allows(time_s: float, policies: int) -> None:
    names = tuple(f"p{number}" for number in range(100))
    template = msgspec.structs.replace(TEMPLATE, scenario=Scenario(start=START, time_limit_s=time_s))
    settings: dict[str, Setting] = {"kept": 0.0, "routed": 0.0, "phases_max": 20}
    made = Strategy(template, settings, names, describe()).ask(3, np.random.default_rng(1))
    assert all(0.5 * policies <= len(read_note(one.origin.note)) <= policies for one in made)


def test_every_mission_drawn_can_be_written_beside_the_others_and_read_again(tmp_path: Path) -> None:
    drawn = [case for case in strategy(missions=1.0, kept=0.0).ask(12, derive(3, "test")) if case.scenario.mission]
    assert len({case.scenario.mission.name for case in drawn if case.scenario.mission}) > 6
    files = [write_case(case, tmp_path)[0] for case in drawn]
    assert [identity(read_case(file)) for file in files] == [identity(case) for case in drawn]


@pytest.mark.parametrize("start_s", [0.5, 60.0, 200.0, 600.0])
def test_missions_shorter_than_the_time_of_the_first_input_are_drawn_too(start_s: float) -> None:
    drawn = strategy(missions=1.0, kept=0.0, routed=0.0, start_s=start_s).ask(12, derive(3, "test"))
    assert sum(case.scenario.mission is not None for case in drawn) == 12


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
    assert len(children) > 10
    assert all(one.scenario.start == flown.scenario.start for one in children)
    assert any(one.origin.note.startswith("to RTL") for one in found)
    assert Hint("upright") in searching._hints.values()


def test_a_corpus_is_sown_as_it_was_kept_and_texts_that_are_none_are_refused() -> None:
    corpus = Corpus()
    flown = case(given("mode", "RTL"))
    corpus.tell(flown, {"a-rtl1": 0.9}, 2)
    texts = corpus.sown()
    searching = strategy(corpus=texts, kept=1.0)
    assert searching._corpus.sown() == texts
    parents = {one.origin.parent for one in searching.ask(40, derive(1, "ask"))}
    assert parents == {"", identity(flown)}  # of a near miss always, else now and then
    with pytest.raises(Refused, match="strategy setting corpus"):
        strategy(corpus=["{}"])
