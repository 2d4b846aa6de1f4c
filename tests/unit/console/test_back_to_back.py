"""What flights on another build make of a flight of a run: equal, alike, by chance, or another."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from saflite.console.operations import back_to_back
from saflite.console.operations.back_to_back import Before, Seen, told
from saflite.console.operations.builds import Sample
from saflite.contract.bounds import Track
from saflite.contract.rng import derive
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import Judgement, Ruling, Transition, Verdict

STIMULI = (Stimulus(at_s=3.0, kind="mode", name="RTL"), Stimulus(at_s=50.0, kind="mode", name="LAND"))
CASE = TestCase(target=Target(), scenario=Scenario(), stimuli=STIMULI)
NEAR_M = 2.0
APART = "9.0 m apart from 5 s on, after mode RTL"


def along(*offsets_m: float) -> Track:
    """A way north at 1 m/s, one point a second, that far to the east."""
    return tuple((float(at), float(at), offset, 20.0) for at, offset in enumerate(offsets_m))


STRAIGHT = along(*[0.0] * 12)
ASIDE = along(*[0.0] * 5, *[9.0] * 7)


def judged(track: Track = STRAIGHT, outcome: Ruling = "held", states: tuple[str, ...] = ("GUIDED", "RTL")) -> Judgement:
    steps = tuple(Transition(before, after) for before, after in pairwise(states))
    verdicts = (Verdict(policy="a-rtl1", outcome=outcome), Verdict(policy="upright", outcome="held"))
    return Judgement(test_case=identity(CASE), flight_index=0, verdicts=verdicts, track=track, transitions=steps)


def flown(judgement: Judgement | None, digest: str = "b", ending: str = "completed") -> Sample:
    return Sample(0, ending, None if judgement is None else judgement.verdicts, digest, "lost", judgement)


BEFORE = Before(identity(CASE), CASE, "a", back_to_back.seen("completed", judged()))


@pytest.mark.parametrize(
    ("samples", "state", "words"),
    [
        ([flown(judged(), "a")], "equal", ""),
        ([flown(judged(along(*[0.5] * 12)))], "alike", ""),
        ([flown(None)], "not flown", "lost"),
        ([flown(judged(ASIDE))] * 4, "differs", APART),
        ([flown(judged(ASIDE)), flown(judged()), flown(judged())], "varies", ""),
        ([flown(judged(outcome="violated"))] * 3, "differs", "violates a-rtl1"),
        ([flown(judged(outcome="violated")), flown(judged())], "varies", ""),
        ([flown(judged(outcome="vacuous"))] * 3, "differs", "1 rule applies in one and not in the other"),
        ([flown(judged(), ending="crashed")] * 3, "differs", "ends crashed, was completed"),
        ([flown(judged(states=("GUIDED", "LAND")))] * 3, "differs", "state 2: LAND, was RTL"),
        (
            [flown(judged(states=("GUIDED", "RTL", "RTL standing")))] * 2,
            "differs",
            "state 3: RTL standing, was nothing",
        ),
        (
            [flown(judged(ASIDE)), flown(None), flown(judged(ASIDE))],
            "differs",
            "9.0 m apart from 5 s on, after mode RTL",
        ),
    ],
)
def test_a_flight_before_and_those_on_a_build(samples: list[Sample], state: str, words: str) -> None:
    result = told(BEFORE, samples, NEAR_M)
    assert (result.state, result.words) == (state, words)


def test_a_violation_that_is_gone_is_said_first() -> None:
    before = BEFORE._replace(seen=back_to_back.seen("completed", judged(outcome="violated")))
    result = told(before, [flown(judged(ASIDE))] * 3, NEAR_M)
    assert result.words == f"no longer violates a-rtl1; {APART}"


def _by_chance(rng: np.random.Generator) -> Seen:
    """One flight of a kind that varies in all that is compared."""
    aside = float(rng.normal(0.0, 10.0))
    outcome: Ruling = "violated" if rng.random() < 0.2 else "held"
    states = ("GUIDED", "RTL") if rng.random() < 0.7 else ("GUIDED", "LAND")
    ending = "crashed" if rng.random() < 0.1 else "completed"
    return back_to_back.seen(ending, judged(along(*[aside] * 12), outcome, states))


@pytest.mark.parametrize("times", [2, 4])
def test_flights_of_one_kind_are_told_to_differ_no_oftener_than_is_said(times: int) -> None:
    """Whatever the things compared, and however many: each of the flights is the only odd one with one chance."""
    rng, differ, runs = derive(7, "back to back", times), 0, 600
    for _ in range(runs):
        one, *others = (_by_chance(rng) for _ in range(times + 1))
        samples = [flown(_as_judgement(other), ending=other.ending) for other in others]
        differ += told(BEFORE._replace(seen=one), samples, NEAR_M).state == "differs"
    assert 0 < differ / runs < 1 / (times + 1) + 0.05


def _as_judgement(what: Seen) -> Judgement:
    return judged(what.track, what.outcomes["a-rtl1"], what.states)


def test_of_memory_safety_the_files_say_no_more_than_that() -> None:
    died = Verdict(policy="autopilot-alive", outcome="violated", message="AddressSanitizer: heap-buffer-overflow in f")
    sample = flown(judged(), ending="autopilot_died")
    result = told(BEFORE, [sample._replace(verdicts=(died,))], NEAR_M)
    assert result.memory_safety
    assert back_to_back.check(result).text == "differs: memory safety, withheld"


def test_the_end_says_how_much_differs_and_how_much_of_it_is_luck() -> None:
    same, other = told(BEFORE, [flown(judged(), "a")], NEAR_M), told(BEFORE, [flown(judged(ASIDE))] * 4, NEAR_M)
    lost = told(BEFORE, [flown(None)], NEAR_M)
    assert back_to_back.summary([same, same, other], 80, 4) == (
        "3 of 80 test cases: 2 equal bit by bit, 1 differ; share that differs 0.06 to 0.79;"
        " of those that vary by chance about one in 5 is told to differ"
    )
    assert [back_to_back.exit_code(them) for them in ([same], [same, other, lost], [same, lost], [])] == [0, 1, 3, 3]
    assert [back_to_back.check(one).outcome for one in (same, other, lost)] == ["passed", "failed", "error"]
