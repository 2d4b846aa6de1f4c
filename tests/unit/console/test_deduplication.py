"""Violations are joined by the least inputs behind them; nothing confirmed is left out, nothing else gets in."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from saflite.console.run_data.deduplication import Find, deduplicate
from saflite.contract.test_case import Obstacle, Origin, Scenario, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import Confirmation, Violation

NAMES = "ABCDE"


def _find(*names: str, policy: str = "p", confirmation: Confirmation = "confirmed", boxes: bool = False) -> Find:
    box = Obstacle(x_m=0.0, y_m=0.0, length_m=1.0, width_m=1.0, height_m=1.0, rotation_deg=0.0)
    case = TestCase(
        target=Target(),
        scenario=Scenario(obstacles=(box,) if boxes else ()),
        stimuli=tuple(
            Stimulus(at_s=1.0 + place, kind="parameter", name=name, values=(2.0,)) for place, name in enumerate(names)
        ),
    )
    violation = Violation(
        fingerprint="f",
        test_case=identity(case),
        policy=policy,
        robustness=-1.0,
        severity="soft",
        confirmation=confirmation,
    )
    return violation, case


def test_larger_violations_belong_to_the_smallest_within_them() -> None:
    found = deduplicate([_find("A", "B", "C"), _find("B", "A"), _find("D", "C"), _find("A", "B", policy="q")])
    told = [(one.policy, one.violations, one.words) for one in found]
    assert told == [
        ("p", 2, "1 s parameter B 2; 2 s parameter A 2"),
        ("p", 1, "1 s parameter D 2; 2 s parameter C 2"),
        ("q", 1, "1 s parameter A 2; 2 s parameter B 2"),
    ]


def test_what_is_not_confirmed_or_about_obstacles_has_no_cause_here() -> None:
    assert deduplicate([_find("A", confirmation="flaky"), _find("A", boxes=True)]) == ()
    assert [one.words for one in deduplicate([_find()])] == ["no input at all"]


@given(st.lists(st.frozensets(st.sampled_from(NAMES)), max_size=12), st.randoms())
def test_every_violation_is_counted_once_whatever_the_order(sets: list[frozenset[str]], rng: object) -> None:
    finds = [_find(*sorted(names)) for names in sets]
    found = deduplicate(finds)
    assert sum(one.violations for one in found) == len(finds)
    least = {names for names in sets if not any(other < names for other in sets)}
    assert {frozenset(stimulus.name for stimulus in one.test_case.stimuli) for one in found} == least
    shuffled = list(finds)
    rng.shuffle(shuffled)  # type: ignore[attr-defined]
    assert deduplicate(shuffled) == found


def test_a_smallest_form_counts_as_the_find_it_was_made_of() -> None:
    """Also where that find's own inputs hold the least of another group: it must not be counted twice."""
    first, second = _find("A", "B", "C"), _find("B", "C", "D")
    forms = [_form_of(first, "A", "B"), _form_of(first, "B"), _form_of(second, "C")]
    found = deduplicate([first, second, *forms], {violation.test_case for violation, _ in forms})
    assert [(one.words, one.violations) for one in found] == [("1 s parameter B 2", 1), ("1 s parameter C 2", 1)]


def _form_of(find: Find, *names: str) -> Find:
    violation, case = _find(*names)
    case = msgspec.structs.replace(case, origin=Origin(strategy="test", parent=find[0].test_case))
    return msgspec.structs.replace(violation, test_case=identity(case)), case
