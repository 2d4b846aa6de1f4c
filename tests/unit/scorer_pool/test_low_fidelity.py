"""What a cheap flight is worth: near is worth more, stuck little unless it collides, the behaviour shown is named."""

from __future__ import annotations

from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase
from saflite.flight.mission import builtin_mission
from saflite.scorer_pool.model import Job, Model, ModelScore, Tools
from saflite.scorer_pool.registry import make

Box = tuple[float, float, float, float, float, float]
NARROW: tuple[Box, Box] = ((9.85, 8.91, 20.29, -4.31, 31.54, 30.7), (2.59, 8.78, 23.52, 9.67, 26.28, 31.8))
WALL: tuple[Box, Box] = ((7.59, 19.3, 18.81, -1.14, 28.55, 70.7), (11.2, 5.81, 20.06, -15.47, 23.7, 78.4))
POCKET: tuple[Box, Box, Box] = (
    (18.33, 6.99, 21.87, -19.05, 28.98, 65.9),
    (16.9, 4.5, 15.23, 9.07, 23.67, 66.6),
    (13.15, 16.21, 17.45, -7.7, 19.57, 3.3),
)
"""Of mission 5: real flights wander in it for minutes, then hit a box."""


class Clock:
    def monotonic_s(self) -> float:
        return 0.0

    def unix_s(self) -> float:
        return 0.0


def part(label: str) -> Model:
    return make(label, Tools(Clock(), part))


def score(label: str, *boxes: Box, mission: str = "mission2") -> ModelScore:
    obstacles = tuple(
        Obstacle(length_m=length, width_m=width, height_m=height, x_m=x, y_m=y, rotation_deg=turn)
        for length, width, height, x, y, turn in boxes
    )
    case = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission(mission), obstacles=obstacles))
    return part(label).score(Job((case,))).scores[0]


def test_a_near_pass_scores_high_and_says_what_is_expected() -> None:
    seen = score("low_fidelity", *NARROW)
    assert seen.value > 7.0
    assert seen.kind.startswith("right of obstacle 2 on leg 1, way "), "as the oracle says of the real flight"
    assert score("blend", *NARROW).kind == seen.kind


def test_a_vehicle_that_is_stuck_far_from_any_box_is_worth_little() -> None:
    seen = score("low_fidelity", *WALL)
    assert "in 500 s" in seen.reason, seen.reason
    assert seen.value <= 2.5
    assert seen.kind == "", "nothing is expected of a flight that keeps 5 m away"


def test_a_vehicle_that_is_stuck_until_it_collides_is_worth_more_than_any_graze() -> None:
    seen = score("low_fidelity", *POCKET, mission="mission5")
    assert seen.reason.endswith("on average of 3 flights, 100% of them below 0.25 m"), seen.reason
    assert seen.value > score("low_fidelity", *NARROW).value + 0.5
    assert seen.kind.endswith(", deep"), "a kind of its own: grazes of the same kind do not make it less"
    assert score("blend", *POCKET, mission="mission5").value > 7.0
