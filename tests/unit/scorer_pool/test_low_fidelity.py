"""What a cheap flight is worth: near is worth more, stuck is worth little, and the behaviour it shows is named."""

from __future__ import annotations

from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase
from saflite.flight.mission import builtin_mission
from saflite.scorer_pool.model import Job, Model, ModelScore, Tools
from saflite.scorer_pool.registry import make

Box = tuple[float, float, float, float, float, float]
NARROW: tuple[Box, Box] = ((9.85, 8.91, 20.29, -4.31, 31.54, 30.7), (2.59, 8.78, 23.52, 9.67, 26.28, 31.8))
WALL: tuple[Box, Box] = ((7.59, 19.3, 18.81, -1.14, 28.55, 70.7), (11.2, 5.81, 20.06, -15.47, 23.7, 78.4))


class Clock:
    def monotonic_s(self) -> float:
        return 0.0

    def unix_s(self) -> float:
        return 0.0


def part(label: str) -> Model:
    return make(label, Tools(Clock(), part))


def score(label: str, *boxes: Box) -> ModelScore:
    obstacles = tuple(
        Obstacle(length_m=length, width_m=width, height_m=height, x_m=x, y_m=y, rotation_deg=turn)
        for length, width, height, x, y, turn in boxes
    )
    case = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2"), obstacles=obstacles))
    return part(label).score(Job((case,))).scores[0]


def test_a_near_pass_scores_high_and_says_what_is_expected() -> None:
    seen = score("low_fidelity", *NARROW)
    assert seen.value > 7.0
    assert seen.kind.startswith("right of obstacle 2 on leg 1, way "), "as the oracle says of the real flight"
    assert score("blend", *NARROW).kind == seen.kind


def test_a_vehicle_that_is_stuck_is_given_up_early_and_worth_little() -> None:
    seen = score("low_fidelity", *WALL)
    assert "was not there after 235 s" in seen.reason, seen.reason
    assert seen.value <= 2.5
    assert seen.kind == "", "nothing is expected of a flight that keeps 5 m away"
