"""The scorer `relevance`: what belongs to a policy scores above what does not, before and after flights."""

from __future__ import annotations

import pytest

from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.contract.work import Outcome
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.model import Job, PolicyBrief, Tools
from saflite.scorer_pool.models.relevance import Model

GPS = PolicyBrief(
    name="gps",
    interestingness="After the GPS is lost the failsafe must be on: interesting is a negative COM_POS_FS_DELAY.",
    signals=("failsafe_gps", "gps_ok"),
)


def _case(*stimuli: tuple[StimulusKind, str, float]) -> TestCase:
    return TestCase(
        scenario=Scenario(start=StartState(mode="GUIDED", altitude_m=30.0)),
        target=Target(),
        stimuli=tuple(
            Stimulus(at_s=1.0 + place, kind=kind, name=name, values=(value,))
            for place, (kind, name, value) in enumerate(stimuli)
        ),
    )


def _none(label: str) -> Model:
    raise AssertionError(f"relevance asked for {label}")


def _scores(*cases: TestCase, brief: PolicyBrief = GPS, history: tuple[Outcome, ...] = ()) -> list[float]:
    model = Model("", Tools(clock=WallClock(), model=_none))
    return [score.value for score in model.score(Job(test_cases=cases, briefs=(brief,), history=history)).scores]


def test_inputs_of_the_policy_score_above_others_and_what_does_not_belong_lowers() -> None:
    loss: tuple[StimulusKind, str, float] = ("sensor_fault", "SIM_GPS_DISABLE", 1.0)
    pure, mixed, foreign = _scores(
        _case(("parameter", "COM_POS_FS_DELAY", 3.0), loss),
        _case(("parameter", "COM_POS_FS_DELAY", 3.0), loss, ("parameter", "CIRCLE_RADIUS", 3.0)),
        _case(("parameter", "CIRCLE_RADIUS", 3.0), ("parameter", "RC3_DZ", 3.0)),
    )
    assert pure > mixed > foreign


@pytest.mark.parametrize("named", [True, False])
def test_negative_values_score_more_exactly_where_the_words_name_them(named: bool) -> None:
    brief = GPS if named else GPS._replace(interestingness=GPS.interestingness.replace("negative", "huge"))
    below, above = _scores(
        _case(("parameter", "COM_POS_FS_DELAY", -3.0)), _case(("parameter", "COM_POS_FS_DELAY", 3.0)), brief=brief
    )
    assert (below > above) if named else (below == above)


def test_an_input_that_came_close_scores_more_after_the_flights() -> None:
    near, far = _case(("parameter", "RC3_DZ", 3.0)), _case(("parameter", "CIRCLE_RADIUS", 3.0))
    history = tuple(
        Outcome(test_case=case, round=0, ending="timed_out", robustness=robustness)
        for case, robustness in [(near, 0.1), (far, 5.0)] * 8
    )
    before, after = _scores(near, far), _scores(near, far, history=history)
    assert after[0] - after[1] > before[0] - before[1]


def test_a_model_asked_about_other_policies_forgets_what_it_worked_out_for_the_first() -> None:
    model, cases = Model("", Tools(clock=WallClock(), model=_none)), (_case(("parameter", "RTL_ALT", 3.0)),)
    other = PolicyBrief(name="rtl", interestingness="A return climbs to RTL_ALT first.", signals=("altitude_m",))
    seen = [model.score(Job(test_cases=cases, briefs=(brief,))).scores[0].value for brief in (GPS, other, GPS)]
    assert seen[1] > seen[0] == seen[2]
    assert [score.value for score in model.score(Job(test_cases=cases)).scores] == [5.0]
