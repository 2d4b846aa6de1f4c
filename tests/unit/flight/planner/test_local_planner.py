"""The compiled planner against direct re-computations in Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle
from saflite.flight.geometry import boxes_array
from saflite.flight.planner.local_planner import IN_COUNT, SHAPE, LocalPlanner, cast, costs, histogram
from saflite.flight.planner.settings import PlannerSettings

ROWS, COLUMNS = SHAPE
EYE = np.array([1.0, 2.0, 10.0])


def wrap(angle: float) -> float:
    return angle - 360.0 * math.floor(angle / 360.0 + 0.5)


def polar(points: NDArray[np.float64], eye: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    d = points - eye
    azimuth = np.degrees(np.arctan2(d[:, 1], d[:, 0]))
    elevation = np.degrees(np.arctan2(d[:, 2], np.hypot(d[:, 0], d[:, 1])))
    return azimuth, elevation, np.linalg.norm(d, axis=1)


def cloud(seed: int, count: int = 400) -> NDArray[np.float32]:
    rng = derive(seed, "cloud")
    return np.asarray(EYE + rng.uniform(-9.0, 9.0, (count, 3)) * np.array([1.0, 1.0, 0.5]), dtype=np.float32)


def plain_histogram(points: NDArray[np.float32], eye: NDArray[np.float64]) -> NDArray[np.float64]:
    azimuth, elevation, distance = polar(points.astype(float), eye)
    total, count = np.zeros(SHAPE), np.zeros(SHAPE)
    row = np.minimum(((elevation + 90) / 6).astype(int), ROWS - 1)
    column = np.minimum(((azimuth + 180) / 6).astype(int), COLUMNS - 1)
    np.add.at(total, (row, column), distance)
    np.add.at(count, (row, column), 1)
    return np.divide(total, count, out=np.zeros(SHAPE), where=count > 0)


def near_an_edge(points: NDArray[np.float32], eye: NDArray[np.float64]) -> NDArray[np.bool_]:
    azimuth, elevation, _ = polar(points.astype(float), eye)
    return (np.abs((azimuth + 3) % 6 - 3) < 0.01) | (np.abs((elevation + 3) % 6 - 3) < 0.01)


def interpolated(row: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    known = list(range(0, COLUMNS, step))
    return np.asarray(np.interp(np.arange(COLUMNS), [*known, COLUMNS], [*row[known], row[0]]))


def padded(matrix: NDArray[np.float64], radius: int) -> NDArray[np.float64]:
    half = COLUMNS // 2
    turned = np.roll(matrix, half, axis=1)
    tall = np.vstack([turned[:radius][::-1], matrix, turned[-radius:][::-1]])
    return np.hstack([tall[:, -radius:], tall, tall[:, :radius]])


def plain_costs(
    mean: NDArray[np.float64],
    velocity: NDArray[np.float64],
    goal: NDArray[np.float64],
    line: NDArray[np.float64],
    s: PlannerSettings,
) -> NDArray[np.float64]:
    """Section 5.4 of the facts, cell by cell."""
    (goal_az, line_az), (goal_el, _), (goal_m, _) = polar(np.array([goal, line]), EYE)
    faced = any(
        s.range_m
        > mean[min(int((goal_el + 6 * j + 90) / 6), ROWS - 1), int((wrap(goal_az + 6 * i) + 180) / 6) % COLUMNS]
        > 0.2
        for j in range(-2, 3)
        for i in range(-5, 6)
    )
    share = 0.0 if faced else 0.5
    other, near = np.zeros(SHAPE), np.zeros(SHAPE)
    for e in range(ROWS):
        el = 6 * e + 3 - 90
        step = round(1 / math.cos(math.radians(el)))
        for z in range(COLUMNS):
            az = 6 * z + 3 - 180
            c = math.cos(math.radians(el))
            u = np.array([c * math.cos(math.radians(az)), c * math.sin(math.radians(az)), math.sin(math.radians(el))])
            pitch = s.pitch_cost * (el - goal_el) ** 2 / ((0.2 * goal_m) ** 2 if goal_m < 5 else 1.0)
            yaw = (1 - share) * wrap(az - goal_az) ** 2 + share * wrap(az - line_az) ** 2
            other[e, z] = s.velocity_cost * (np.linalg.norm(velocity) - u @ velocity) + s.yaw_cost * yaw + pitch
            if mean[e, z] > 0:
                d = s.obstacle_knee_m - mean[e, z]
                near[e, z] = 5000.0 * (1 + d / math.sqrt(1 + d * d))
        other[e], near[e] = interpolated(other[e], step), interpolated(near[e], step)
    radius = s.smoothing_radius_cells
    kernel = (radius + 1 - np.abs(np.arange(-radius, radius + 1))) / (radius + 1)
    wide = padded(near, radius)
    smooth = np.zeros(SHAPE)
    for e in range(ROWS):
        for z in range(COLUMNS):
            smooth[e, z] = kernel @ wide[e : e + 2 * radius + 1, z : z + 2 * radius + 1] @ kernel
    return other + smooth


@pytest.mark.parametrize("seed", range(5))
def test_histogram_is_the_mean_distance_per_cell(seed: int) -> None:
    points = cloud(seed)
    points = points[~near_an_edge(points, EYE)]
    np.testing.assert_allclose(histogram(points, EYE), plain_histogram(points, EYE), rtol=1e-5)


@pytest.mark.parametrize(
    ("seed", "goal"), [(0, (30.0, 40.0, 10.0)), (1, (-20.0, 5.0, 12.0)), (2, (2.5, 4.0, 9.0)), (3, (1.0, -30.0, 3.0))]
)
def test_costs_are_those_of_the_original(seed: int, goal: tuple[float, float, float]) -> None:
    points = cloud(seed, 60 if seed % 2 else 400)
    points = points[~near_an_edge(points, EYE)]
    velocity, target, line = np.array([0.8, -0.6, 0.1]), np.array(goal), np.array([5.0, 25.0, 10.0])
    found = costs(points, EYE, velocity, target, line)
    expected = plain_costs(plain_histogram(points, EYE), velocity, target, line, PlannerSettings())
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=15.0)


def box(**changes: float) -> Obstacle:
    numbers = {"length_m": 6.0, "width_m": 4.0, "height_m": 20.0, "x_m": 1.0, "y_m": 12.0, "rotation_deg": 30.0}
    return Obstacle(**(numbers | changes))


def test_every_point_seen_lies_on_a_face_within_range_and_view() -> None:
    boxes = boxes_array([box(), box(x_m=7.0, y_m=9.0, rotation_deg=0.0)])
    points = cast(EYE, math.radians(90), boxes).astype(float)
    azimuth, elevation, distance = polar(points, EYE)
    assert len(points) > 100
    assert np.all(np.abs(azimuth - 90) < 29.6)
    assert np.all(np.abs(elevation) < 23.1)
    assert np.all(distance < 15.0)
    gaps = []
    for row in boxes:
        dx, dy = points[:, 0] - row[0], points[:, 1] - row[1]
        along, across = dx * row[4] + dy * row[5], dy * row[4] - dx * row[5]
        gaps.append(np.maximum(np.abs(along) - row[2], np.abs(across) - row[3]))
    assert np.all(np.abs(np.array(gaps)).min(axis=0) < 1e-4)


def test_a_hidden_box_is_not_seen() -> None:
    front = box(length_m=20.0, width_m=1.0, rotation_deg=0.0, y_m=8.0)
    behind = box(length_m=2.0, width_m=2.0, y_m=12.0)
    alone = cast(EYE, math.radians(90), boxes_array([front]))
    assert np.array_equal(cast(EYE, math.radians(90), boxes_array([front, behind])), alone)


def test_a_low_box_shows_its_roof_and_lets_the_view_pass() -> None:
    low = box(height_m=7.0, length_m=30.0, width_m=10.0, rotation_deg=0.0, y_m=13.0)
    heights = cast(EYE, math.radians(90), boxes_array([low]))[:, 2]
    assert heights.max() == pytest.approx(7.0, abs=1e-4)
    assert (np.abs(heights - 7.0) < 1e-4).sum() > 10


def test_one_point_per_two_degree_cell() -> None:
    azimuth, elevation, _ = polar(cast(EYE, 1.5, boxes_array([box()])).astype(float), EYE)
    cells = {(int((a + 180) / 2), int((e + 90) / 2)) for a, e in zip(azimuth, elevation, strict=True)}
    assert len(cells) >= 0.99 * len(azimuth)  # cell borders are met to 3e-4 degrees


def fly_steps(seed: int, steps: int = 120) -> NDArray[np.float64]:
    planner = LocalPlanner(boxes_array([box()]))
    rng = derive(seed, "walk")
    at, log = np.array([0.0, 0.0, 10.0]), []
    for i in range(steps):
        planner.inputs[:] = 0.0
        planner.inputs[0], planner.inputs[1:4], planner.inputs[4:7] = 0.1 * i, at, (0.0, 1.0, 0.0)
        planner.inputs[7], planner.inputs[8:11], planner.inputs[14:17] = 1.57, (0.0, 50.0, 10.0), at
        log.append(planner.step().copy())
        at = at + np.array([0.02, 0.1, 0.0]) + 0.01 * rng.standard_normal(3)
    return np.array(log)


def test_equal_calls_give_equal_answers_and_planners_do_not_share() -> None:
    first = fly_steps(1)
    fly_steps(2)
    assert np.array_equal(first, fly_steps(1))
    assert not np.array_equal(first, fly_steps(2))


def test_far_from_everything_the_set_point_lies_towards_the_goal() -> None:
    planner = LocalPlanner(np.zeros((0, 8)))
    for i in range(60):
        planner.inputs[:] = 0.0
        planner.inputs[0], planner.inputs[3], planner.inputs[7] = 0.1 * i, 10.0, math.pi / 2
        planner.inputs[8:11], planner.inputs[16] = (0.0, 50.0, 10.0), 10.0
        out = planner.step()
    settings = PlannerSettings()
    straight_m = settings.look_ahead_m * (1 - abs(settings.fov_centre_deg) / (settings.fov_learnt_deg / 2))
    assert out[5] == 1.0
    assert out[4] == pytest.approx(straight_m, rel=0.02)
    assert out[:3] == pytest.approx([0.0, straight_m, 10.0], abs=0.05)
    assert len(planner.inputs) == IN_COUNT


def test_a_path_round_a_box_stays_out_of_it() -> None:
    planner = LocalPlanner(boxes_array([box(x_m=0.5, rotation_deg=0.0)]))
    for i in range(10):
        planner.inputs[:] = 0.0
        planner.inputs[0], planner.inputs[3], planner.inputs[7] = 0.1 * i, 10.0, math.pi / 2
        planner.inputs[2] = planner.inputs[15] = 2.0
        planner.inputs[8:11], planner.inputs[16] = (0.0, 50.0, 10.0), 10.0
        planner.step()
    path = planner.path()
    assert len(path) >= 3
    assert np.allclose(np.linalg.norm(np.diff(path, axis=0), axis=1), 2.0, atol=1e-4)
    inside = (np.abs(path[:, 0] - 0.5) < 3.0) & (np.abs(path[:, 1] - 12.0) < 2.0)
    assert not inside.any()
