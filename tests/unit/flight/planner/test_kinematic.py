"""Kinematic missions, the follower's two habits, distances and the gap."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from shapely import LineString, Point, Polygon

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle
from saflite.flight.geometry import boxes_array, corners
from saflite.flight.planner.follower import Follower
from saflite.flight.planner.gap import box_gaps
from saflite.flight.planner.kinematic import KinematicSettings, fly_kinematic
from saflite.flight.planner.settings import VehicleSettings

MISSION2 = np.array([[0.0, 0.0, 10.0], [-6.83, 53.98, 10.0], [-12.35, 0.14, 0.0]])
NONE = np.zeros((0, 8))


def random_boxes(seed: int, count: int) -> tuple[Obstacle, ...]:
    rng = derive(seed, "boxes")
    return tuple(
        Obstacle(
            length_m=float(rng.uniform(2, 12)),
            width_m=float(rng.uniform(2, 8)),
            height_m=float(rng.uniform(10, 25)),
            x_m=float(15 * (-1) ** k + rng.uniform(-3, 3)),
            y_m=float(15 + 9 * k + rng.uniform(-1, 1)),
            rotation_deg=float(rng.uniform(0, 90)),
        )
        for k in range(count)
    )


@pytest.mark.parametrize(
    ("mission", "real_s"),
    [
        (np.array([[0.0, 0.0, 10.0], [3.31, 53.1, 0.0]]), 85.0),
        (MISSION2, 134.0),
        (np.array([[0.0, 0.0, 10.0], [3.31, 53.1, 10.0], [-14.69, 54.12, 10.0], [-17.86, 1.0, 0.0]]), 147.0),
    ],
)
def test_free_missions_take_the_real_time(mission: NDArray[np.float64], real_s: float) -> None:
    flight = fly_kinematic(mission, NONE, rng_seed=1)
    assert flight.ending == "completed"
    assert flight.duration_s == pytest.approx(real_s, rel=0.1)
    assert flight.min_distance_m == 1000.0
    assert np.hypot(*(flight.track[-1, 1:3] - mission[-1, :2])) < 1.5
    assert flight.track[-1, 3] < 0.1


def test_equal_seeds_fly_bit_equal_and_others_scatter() -> None:
    boxes = boxes_array(random_boxes(3, 2))
    first, again, other = (fly_kinematic(MISSION2, boxes, rng_seed=seed) for seed in (5, 5, 6))
    assert np.array_equal(first.track, again.track)
    assert first[:2] == again[:2]
    assert not np.array_equal(first.track[: len(other.track)], other.track[: len(first.track)])


def test_the_distance_told_is_that_of_the_track() -> None:
    obstacles = random_boxes(4, 3)
    flight = fly_kinematic(MISSION2, boxes_array(obstacles), rng_seed=2)
    line = LineString(flight.track[:, 1:3])
    for obstacle, clearance_m in zip(obstacles, flight.clearance_m, strict=True):
        assert clearance_m == pytest.approx(line.distance(Polygon(corners(obstacle))), abs=0.02)
    assert flight.min_distance_m == min(flight.clearance_m)


def test_a_wall_across_the_way_is_never_flown_through() -> None:
    wall = Obstacle(length_m=20.0, width_m=4.0, height_m=25.0, x_m=-3.0, y_m=25.0)
    for seed in range(3):
        flight = fly_kinematic(MISSION2, boxes_array((wall,)), rng_seed=seed)
        assert flight.min_distance_m > 0.3
        off = np.abs(flight.track[:, 1:3] - [-3.0, 25.0])
        assert not ((off[:, 0] < 8.0) & (off[:, 1] < 1.6)).any()


def test_the_time_limit_ends_a_flight() -> None:
    vehicle = msgspec.structs.replace(VehicleSettings(), time_limit_s=60.0)
    flight = fly_kinematic(MISSION2, NONE, settings=KinematicSettings(vehicle=vehicle))
    assert flight.ending == "timed_out"
    assert flight.duration_s == pytest.approx(60.0)


@pytest.mark.parametrize("mission", [np.zeros((1, 3)), np.full((3, 3), np.nan)])
def test_an_impossible_mission_is_refused(mission: NDArray[np.float64]) -> None:
    with pytest.raises(Refused, match="mission"):
        fly_kinematic(mission, NONE)


def creep_speed(lock: float) -> float:
    """Fly off the line after a near stop and return the speed in the end."""
    at, speed = (3.0, 0.0, 10.0), 0.0
    follower = Follower(at, (0.0, 0.0, 0.0), msgspec.structs.replace(VehicleSettings(), turn_lock=lock))
    follower.leg((0.0, 0.0, 10.0), (0.0, 50.0, 10.0), at)
    for i in range(400):
        ahead = min(2.4, 0.3 + 0.004 * i)
        x, y, z, vx, vy, _ = follower.step(at, (at[0] + ahead, at[1], 10.0), 0.05)
        at, speed = (x, y, z), float(np.hypot(vx, vy))
    return speed


def test_a_turn_off_the_line_is_held_at_the_speed_before_it() -> None:
    assert 0.2 < creep_speed(1.0) < 0.6
    assert creep_speed(0.0) > 1.0


@pytest.mark.parametrize("seed", range(20))
def test_gaps_are_shapely_distances(seed: int) -> None:
    obstacles = random_boxes(seed, 2 + seed % 3)
    shapes = [Polygon(corners(obstacle)) for obstacle in obstacles]
    boxes = boxes_array(obstacles)[None]
    least = min(a.distance(b) for i, a in enumerate(shapes) for b in shapes[:i])
    assert box_gaps(boxes)[0] == pytest.approx(least, abs=1e-9)


def test_points_over_a_box_are_measured_from_its_roof() -> None:
    low = Obstacle(length_m=8.0, width_m=8.0, height_m=6.0, x_m=-3.4, y_m=27.0)
    flight = fly_kinematic(MISSION2, boxes_array((low,)), rng_seed=0)
    over = [row for row in flight.track if Polygon(corners(low)).contains(Point(row[1], row[2]))]
    if over:
        assert flight.min_distance_m <= min(row[3] for row in over) - 6.0 + 1e-6
    assert flight.min_distance_m > 0.0
