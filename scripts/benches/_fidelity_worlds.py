"""The worlds that can be measured: the kinematic vehicle and the JSBSim target."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase
from saflite.flight.geometry import boxes_array
from saflite.flight.mission import builtin_mission, waypoints
from saflite.flight.planner.kinematic import KinematicSettings, fly_kinematic


class Flown(NamedTuple):
    """One flight: `track` has rows x, y, z (m); `duration_s` counts from the start of a real log."""

    min_distance_m: float
    duration_s: float
    track: NDArray[np.float64]


class World(Protocol):
    """Flies a built-in mission among obstacles."""

    def __call__(self, mission: str, obstacles: tuple[Obstacle, ...], rng_seed: int, limit_s: float) -> Flown:
        """Return the flight."""
        ...


def legs(mission: str) -> NDArray[np.float64]:
    """Return the mission as rows x, y, z for the kinematic vehicle."""
    return np.array([(point.x_m, point.y_m, point.z_m) for point in waypoints(builtin_mission(mission))])


class Kinematic:
    """The kinematic vehicle with given settings."""

    def __init__(self, settings: KinematicSettings | None = None) -> None:
        self._settings = settings or KinematicSettings()

    def __call__(self, mission: str, obstacles: tuple[Obstacle, ...], rng_seed: int, limit_s: float) -> Flown:
        """Return the flight."""
        vehicle = msgspec.structs.replace(self._settings.vehicle, time_limit_s=limit_s)
        settings = self._settings._replace(vehicle=vehicle)
        flight = fly_kinematic(legs(mission), boxes_array(obstacles), rng_seed=rng_seed, settings=settings)
        return Flown(flight.min_distance_m, flight.duration_s, flight.track[:, 1:4])


class JSBSim:
    """The reference target on JSBSim."""

    def __call__(self, mission: str, obstacles: tuple[Obstacle, ...], rng_seed: int, limit_s: float) -> Flown:
        """Return the flight; its trace is thinned to 2 Hz for the track."""
        from saflite.conformance.flying import fly_once

        scenario = Scenario(mission=builtin_mission(mission), obstacles=obstacles, time_limit_s=limit_s)
        record = fly_once(TestCase(target=Target(), scenario=scenario, rng_seed=rng_seed))
        assert record.trace is not None, record.message
        every = max(1, round(0.5 / record.trace.step_s))
        columns = [record.trace.array(name)[::every].astype(float) for name in ("x_m", "y_m", "altitude_m")]
        distance_m = float(record.trace.array("obstacle_distance_m").min())
        return Flown(distance_m, record.trace.duration_s, np.stack(columns, axis=1))


WORLDS: dict[str, type[Kinematic] | type[JSBSim]] = {"kinematic": Kinematic, "jsbsim": JSBSim}
