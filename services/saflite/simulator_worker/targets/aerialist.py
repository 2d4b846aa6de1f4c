"""Aerialist: PX4-Avoidance on Gazebo in the competition's container, in real time; not tried on its image yet."""

from __future__ import annotations

import hashlib
import shutil

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.ids import short_id
from saflite.contract.service import Cancelled
from saflite.contract.signals import MODES
from saflite.contract.target import Slot
from saflite.contract.target_info import TargetInfo, check_settings
from saflite.contract.test_case import TestCase, Wind
from saflite.flight.autopilots.aerialist import bench
from saflite.flight.autopilots.aerialist.container import IMAGE, Image, named_image
from saflite.flight.build import build_of
from saflite.flight.mission import waypoints

NAME = "aerialist"
TIME_LIMIT_MAX_S = 900.0


def describe() -> TargetInfo:
    """Say what the target is and can do here."""
    missing, build = "", ""
    try:
        ours = build_of(NAME, ("numpy", "pyulog", "pyyaml"), ("competition", "logs"))
        build = hashlib.sha256(f"{ours} {named_image().digest}".encode()).hexdigest()
    except Unavailable as fault:
        missing = str(fault)
    return TargetInfo(
        name=NAME,
        build=build,
        repeats="statistically",
        inputs=(),
        signals=bench.SIGNALS,
        modes=MODES,
        missions=True,
        obstacles=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle="Iris quadcopter (Gazebo)",
        autopilot="PX4-Avoidance in Aerialist's container",
        options="PX4-Autopilot with PX4-Avoidance, as the image holds them",
        stock=False,
        needs=("docker or podman", f"the image {IMAGE}"),
        missing=missing,
    )


def check(test_case: TestCase) -> None:
    """Raise Refused where Aerialist's test file has no words for the test case."""
    scenario, target = test_case.scenario, test_case.target
    if scenario.mission is None:
        raise Refused("mission", where=NAME, expected="a mission to fly", got="none")
    waypoints(scenario.mission)
    if not 0.0 < scenario.time_limit_s <= TIME_LIMIT_MAX_S:
        raise Refused("time_limit_s", expected=f"above 0, at most {TIME_LIMIT_MAX_S:g}", got=scenario.time_limit_s)
    if len(scenario.obstacles) > bench.BOXES_MAX:
        raise Refused("obstacles", expected=f"at most {bench.BOXES_MAX}", got=len(scenario.obstacles))
    if scenario.wind != Wind():
        raise Refused("wind", where=NAME, expected="none", got=scenario.wind)
    check_settings(target.settings, {}, NAME)
    for name in target.parameters:
        raise Refused("parameter", where=NAME, expected="none: the competition's own are set", got=repr(name))
    if test_case.stimuli:
        raise Refused("stimulus", where=NAME, expected="none but the start of the mission", got=test_case.stimuli[0])


def open(slot: Slot) -> AerialistSession:  # noqa: A001  (the name that the contract gives it)
    """Return a session; raises Unavailable where there is no engine or no image."""
    return AerialistSession(slot, named_image())


class AerialistSession:
    """Flies each test case in a container of its own, so that nothing of a flight reaches the next."""

    def __init__(self, slot: Slot, image: Image) -> None:
        self._slot, self._image = slot, image
        self._container = f"saflite-{short_id(str(slot.folder).encode())}"  # the slot's own: one left behind goes first

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once, in real time; `wedged` where `deadline_s` is not enough.

        Raises:
            Refused: see `check`.
            Unavailable: the container or the simulation does not come up, gives no log, or the flight was cancelled.
        """
        check(test_case)
        clock, folder = self._slot.clock, self._slot.folder / "aerialist"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        late_s = clock.monotonic_s() + deadline_s
        return bench.fly(self._image, self._container, folder, test_case, clock, late_s, cancelled)

    def close(self) -> None:
        """End the container, if one is left."""
        self._image.remove(self._container)
