"""Which candidates are flown."""

from __future__ import annotations

from saflite.campaign.scheduling.selection import Expected, Rules, count_promise, select
from saflite.contract.test_case import Obstacle, Scenario, Stimulus, Target, TestCase
from saflite.flight.novelty import Features, distances, features


def case(x_m: float, rotation_deg: float = 0.0) -> TestCase:
    box = Obstacle(length_m=10, width_m=4, height_m=20, x_m=x_m, y_m=5, rotation_deg=rotation_deg)
    return TestCase(target=Target(), scenario=Scenario(obstacles=(box,)))


CASES = {f"{number:02d}": case(10.0 * number) for number in range(10)}


def novelty(one: Features, others: list[Features]) -> float:
    return float(distances([one], others).min(initial=1.0))


def rules(flights: int = 3, random_share: float = 0.0, novelty_weight: float = 0.5, number: int = 0) -> Rules:
    return Rules(flights, random_share, novelty_weight, 1, number)


def test_the_bands_come_before_anything_else() -> None:
    scores = dict.fromkeys(CASES, 3.9) | {"01": 4.0, "02": 7.0, "03": 7.1, "04": 9.0}
    picks = select(CASES, scores, [], rules(4))
    assert [pick.test_case for pick in picks] == ["04", "03", "02", "01"]
    assert {pick.selected_by for pick in picks} == {"score"}


def test_near_twins_of_what_was_flown_come_last_among_equals() -> None:
    scores = dict.fromkeys(CASES, 5.0)
    picks = select(CASES, scores, [features(case(10.0 * number + 0.1)) for number in range(9)], rules(1))
    assert picks[0].test_case == "09"


def test_what_is_picked_makes_its_twins_less_novel() -> None:
    cases = {"a": case(0.0), "b": case(0.01), "c": case(30.0)}
    picks = select(cases, {"a": 6.0, "b": 6.0, "c": 5.8}, [], rules(2))
    assert "c" in {pick.test_case for pick in picks}


def test_order_of_arrival_does_not_matter() -> None:
    scores = {name: float(number % 4) + 4.0 for number, name in enumerate(CASES)}
    backwards = dict(reversed(CASES.items()))
    assert select(CASES, scores, [], rules(5, 0.4)) == select(
        backwards, dict(reversed(scores.items())), [], rules(5, 0.4)
    )


def test_the_random_share_holds_on_average_and_ignores_scores() -> None:
    scores = {name: 10.0 if name < "05" else 0.0 for name in CASES}
    drawn = [
        pick
        for number in range(400)
        for pick in select(CASES, scores, [], rules(4, 0.125, number=number))
        if pick.selected_by == "random"
    ]
    assert 150 < len(drawn) < 250  # 4 x 0.125 x 400 = 200 expected
    dull = sum(1 for pick in drawn if pick.score == 0.0)
    assert 0.35 < dull / len(drawn) < 0.65


def test_fewer_candidates_than_flights_are_all_flown_once() -> None:
    few = {name: CASES[name] for name in ("00", "01")}
    picks = select(few, dict.fromkeys(few, 1.0), [], rules(8, 0.5))
    assert sorted(pick.test_case for pick in picks) == ["00", "01"]
    assert select({}, {}, [], rules()) == ()


def test_novelty_is_a_distance() -> None:
    here, there = features(case(0.0)), features(case(30.0))
    assert novelty(here, [here]) == 0.0
    assert novelty(here, [there]) == novelty(there, [here]) == 1.0
    assert novelty(here, [there, features(case(1.0))]) < 0.2
    assert novelty(features(case(0.0, 180.0)), [here]) < 1e-6
    assert novelty(features(case(0.0, 90.0)), [here]) > 0.1
    assert novelty(here, []) == 1.0


def test_stimuli_with_other_names_have_nothing_in_common() -> None:
    def with_stimulus(name: str, value: float) -> TestCase:
        stimulus = Stimulus(at_s=1.0, kind="parameter", name=name, values=(value,))
        return TestCase(target=Target(), scenario=Scenario(), stimuli=(stimulus,))

    one = features(with_stimulus("A", 1.0))
    assert novelty(one, [features(with_stimulus("B", 1.0))]) == 1.0
    assert 0.0 < novelty(one, [features(with_stimulus("A", 2.0))]) < 1.0
    assert novelty(one, [features(with_stimulus("A", float("nan")))]) == 1.0


def test_one_more_of_a_kind_is_worth_less_than_another_kind() -> None:
    scores = {"00": 9.0, "01": 8.9, "02": 5.0, "03": 8.8}
    kinds = {"00": "left of 1", "01": "left of 1", "02": "right of 2"}
    cases = {name: CASES[name] for name in scores}
    picks = select(cases, scores, [], rules(3, novelty_weight=0.0), Expected(kinds))
    assert [pick.test_case for pick in picks] == ["00", "03", "02"], "8.9 / 1.9 is less than 5.0"
    assert [pick.score for pick in picks] == [9.0, 8.8, 5.0], "scores are told as they were given"


def test_finds_that_earlier_rounds_promise_count() -> None:
    scores = {"00": 9.0, "01": 4.0}
    cases, kinds = {name: CASES[name] for name in scores}, {"00": "left of 1", "01": "right of 2"}
    promised: dict[str, float] = {}
    for _ in range(2):
        count_promise(promised, "left of 1", 9.0)
    count_promise(promised, "", 9.0)
    assert promised == {"left of 1": 1.8}
    assert select(cases, scores, [], rules(1), Expected(kinds, promised))[0].test_case == "01"
    assert select(cases, scores, [], rules(1), Expected(kinds, {}))[0].test_case == "00"


def test_what_is_drawn_at_random_counts_for_its_kind() -> None:
    scores, kinds = dict.fromkeys(CASES, 8.0), dict.fromkeys(CASES, "a") | {"05": "b"}
    picks = select(CASES, scores, [], rules(2, random_share=0.5, novelty_weight=0.0), Expected(kinds))
    assert {kinds[pick.test_case] for pick in picks} == {"a", "b"}
