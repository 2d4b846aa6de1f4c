"""What a campaign put to the test: counted once per flight, the silent rules named, shown in words."""

from __future__ import annotations

import msgspec

from saflite.campaign.engine.exposure import Exposure
from saflite.console.view.live import exposed
from saflite.console.view.report.data import modes_unseen, states_named
from saflite.contract.control import Exposed
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase
from saflite.contract.verdict import Judgement, Transition, Verdict
from saflite.flight.autopilots.described import default_target

STICK = Stimulus(at_s=1.0, kind="stick", name="RC1", values=(1500.0,))
CASE = TestCase(target=Target(), scenario=Scenario(), stimuli=(STICK,))


def judgement(*spoke: str) -> Judgement:
    verdicts = [Verdict(policy=name, outcome="held", robustness=1.0) for name in spoke]
    silent = [Verdict(policy=name, outcome="vacuous", nearness=0.5) for name in ("a", "b", "c") if name not in spoke]
    steps = (
        Transition("LOITER", "RTL", 0, -1),
        Transition("RTL", "RTL gps", -1, 0),
        Transition("RTL gps", "RTL", -1, 0),
    )
    return Judgement(test_case="0" * 16, flight_index=0, verdicts=(*verdicts, *silent), transitions=steps)


def test_rules_states_and_steps_are_counted_once_per_flight() -> None:
    exposure = Exposure()
    exposure.add(CASE, judgement("a"))
    exposure.add(CASE, judgement("a", "b"))
    assert exposure.applied == {"a": 2, "b": 1}
    assert exposure.applied_share(("a", "b", "c")) == 0.5
    assert exposure.states == {"LOITER": 2, "RTL": 2, "RTL gps": 2}
    assert exposure.steps == {
        ("LOITER", "RTL", "stick", ""),
        ("RTL", "RTL gps", "", "stick"),
        ("RTL gps", "RTL", "", "stick"),
    }


def test_a_rule_named_twice_is_one_rule() -> None:
    exposure = Exposure()
    exposure.add(CASE, judgement("a", "a"))
    assert exposure.applied == {"a": 1}
    assert exposure.applied_share(("a", "a")) == 1.0
    exposure.applied["a"] = 2  # as an earlier version counted, in a snapshot
    assert exposure.applied_share(("a", "a", "b")) == 0.5


def test_silent_rules_and_modes_never_flown_are_named() -> None:
    told = exposed(Exposed(spoke=2, silent=("c", "d", "e", "f", "g"), applied_share=0.5, states=3, steps=4))
    assert told == ("2 of 7 rules applied, in 50% of verdicts; never: c, d, e, f ...", "3 states, 4 steps")
    unseen = modes_unseen(default_target(), ("LOITER standing", "RTL"))
    assert "FLIP" in unseen
    assert "LOITER" not in unseen
    assert modes_unseen(default_target(), ()) == ()


def test_states_bear_the_modes_names_of_the_target_that_flew() -> None:
    target = msgspec.structs.replace(default_target(), modes={"ANGLE": 0, "RESCUE": 6, "FAILSAFE": 31})
    seen = {"STABILIZE standing": 3, "RTL": 2, "mode 31 disarmed radio": 1, "mode 40": 1}
    named = states_named(target, seen)
    assert named == {"ANGLE standing": 3, "RESCUE": 2, "FAILSAFE disarmed radio": 1, "mode 40": 1}
    assert modes_unseen(target, named) == ()
