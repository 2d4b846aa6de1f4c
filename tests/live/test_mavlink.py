"""The MAVLink server flown by a real ground station (MAVProxy), by pymavlink over TCP and UDP, and by MAVSDK."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from saflite.flight.autopilots.reference.sitl import serve
from saflite.runtime.clock import WallClock

pytestmark = pytest.mark.live
mavutil = pytest.importorskip("pymavlink.mavutil", reason="pymavlink is not installed")


@pytest.fixture
def served() -> Iterator[Callable[[str], str]]:
    """Return a function that serves the vehicle at four times real time and returns where."""
    stopped, threads = threading.Event(), []

    def start(endpoint: str) -> str:
        bound: list[str] = []
        up = threading.Event()

        def ready(name: str) -> None:
            bound.append(name)
            up.set()

        thread = threading.Thread(
            target=serve, args=(endpoint, WallClock()), kwargs={"speed": 4.0, "stop": stopped.is_set, "ready": ready}
        )
        thread.start()
        threads.append(thread)
        assert up.wait(20.0)
        return bound[0]

    yield start
    stopped.set()
    for thread in threads:
        thread.join(10.0)


def wait_for(link: Any, kind: str, good: Callable[[Any], bool], timeout_s: float = 20.0) -> Any:
    clock = WallClock()
    end_s = clock.monotonic_s() + timeout_s
    while clock.monotonic_s() < end_s:
        message = link.recv_match(type=kind, blocking=True, timeout=1.0)
        if message is not None and good(message):
            return message
    raise AssertionError(f"no fitting {kind} within {timeout_s} s")


def asks_for(index: int, request: Any) -> bool:
    return bool(request.seq == index)


def command(link: Any, number: int, *values: float) -> int:
    numbers = [*values, *([0.0] * 7)][:7]
    link.mav.command_long_send(1, 1, number, 0, *numbers)
    answer = wait_for(link, "COMMAND_ACK", lambda ack: ack.command == number)
    return int(answer.result)


@pytest.mark.parametrize("kind", ["tcp", "udp"])
def test_pymavlink_flies_a_mission(served: Callable[[str], str], kind: str) -> None:
    bound = served(f"{kind}:127.0.0.1:0")
    link = mavutil.mavlink_connection(bound.replace("udp:", "udpout:"), source_system=255)
    link.mav.heartbeat_send(6, 8, 0, 0, 0)
    assert link.wait_heartbeat(timeout=20).autopilot == 3

    link.mav.param_set_send(1, 1, b"RTL_ALT", 900.0, 9)
    wait_for(link, "PARAM_VALUE", lambda p: p.param_id == "RTL_ALT" and p.param_value == 900.0)
    link.mav.param_set_send(1, 1, b"RTL_ALT", -5.0, 9)
    wait_for(link, "PARAM_VALUE", lambda p: p.param_id == "RTL_ALT" and p.param_value == 900.0)

    places = [(22, 0.0, 0.0, 5.0), (16, 47.3978, 8.5456, 6.0), (20, 0.0, 0.0, 0.0)]
    link.mav.mission_count_send(1, 1, len(places) + 1)
    rows = [(16, 47.3977419, 8.5455938, 488.0), *places]
    for index, (number, lat, lon, height) in enumerate(rows):
        wait_for(link, "MISSION_REQUEST_INT", partial(asks_for, index))
        link.mav.mission_item_int_send(
            1, 1, index, 3, number, 0, 1, 0, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), height
        )
    assert wait_for(link, "MISSION_ACK", lambda ack: True).type == 0

    link.set_mode(4)
    wait_for(link, "HEARTBEAT", lambda h: h.custom_mode == 4)
    assert command(link, 400, 1) == 0
    assert command(link, 22, 0, 0, 0, 0, 0, 0, 5) == 0
    wait_for(link, "GLOBAL_POSITION_INT", lambda p: p.relative_alt > 4000)
    assert command(link, 300) == 0
    wait_for(link, "HEARTBEAT", lambda h: h.custom_mode == 6)
    link.mav.rc_channels_override_send(1, 1, 1500, 1500, 1550, 1500, 0, 0, 0, 0)
    wait_for(link, "RC_CHANNELS", lambda r: r.chan3_raw == 1550)
    link.set_mode(9)
    wait_for(link, "HEARTBEAT", lambda h: h.base_mode & 128 == 0, timeout_s=40.0)
    link.close()


def insist(process: subprocess.Popen[str], order: str, link: Any, kind: str, good: Callable[[Any], bool]) -> None:
    """Type an order into MAVProxy until it shows (MAVProxy needs a moment to learn what it talks to)."""
    assert process.stdin is not None
    for _ in range(20):
        process.stdin.write(f"{order}\n")
        process.stdin.flush()
        try:
            wait_for(link, kind, good, timeout_s=2.0)
        except AssertionError:
            continue
        return
    raise AssertionError(f"MAVProxy's {order!r} had no effect")


def test_mavproxy_arms_and_takes_off(served: Callable[[str], str], tmp_path: Path) -> None:
    program = Path(sys.executable).parent / "mavproxy.py"
    if not program.exists():
        pytest.skip("MAVProxy is not installed (pip install MAVProxy)")
    bound = served("tcp:127.0.0.1:0")
    process = subprocess.Popen(
        [sys.executable, str(program), f"--master={bound}"],
        cwd=tmp_path,
        env={**os.environ, "HOME": str(tmp_path), "MPLCONFIGDIR": str(tmp_path), "TERM": "dumb"},
        stdin=subprocess.PIPE,
        stdout=(tmp_path / "mavproxy.log").open("w"),
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        link = mavutil.mavlink_connection(bound, source_system=254)
        insist(process, "mode guided", link, "HEARTBEAT", lambda h: h.custom_mode == 4)
        insist(process, "arm throttle", link, "HEARTBEAT", lambda h: h.base_mode & 128 != 0)
        insist(process, "takeoff 6", link, "GLOBAL_POSITION_INT", lambda p: p.relative_alt > 1000)
        wait_for(link, "GLOBAL_POSITION_INT", lambda p: p.relative_alt > 5000, timeout_s=40.0)
        link.close()
    finally:
        process.kill()  # it ignores a polite end while threads of its modules run
        process.wait(10.0)


async def _fly_with_mavsdk(address: str) -> float:
    """Arm, take off, land and wait until disarmed; returns the greatest height reported."""
    sdk = pytest.importorskip("mavsdk_grpc", reason="mavsdk-grpc is not installed")
    drone = sdk.System()
    await drone.connect(system_address=address)
    async for state in drone.core.connection_state():
        if state.is_connected:
            break
    async for health in drone.telemetry.health():
        if health.is_global_position_ok and health.is_home_position_ok:
            break
    await drone.action.set_takeoff_altitude(8)
    await drone.action.arm()
    await drone.action.takeoff()
    highest_m = 0.0
    async for position in drone.telemetry.position():
        highest_m = max(highest_m, position.relative_altitude_m)
        if highest_m > 6:
            break
    await drone.action.land()
    async for armed in drone.telemetry.armed():
        if not armed:
            break
    return highest_m


def test_mavsdk_takes_off_and_lands(served: Callable[[str], str]) -> None:
    """An SDK with a MAVLink implementation of its own (C++), not pymavlink's."""
    bound = served("tcp:127.0.0.1:0")
    height_m = asyncio.run(asyncio.wait_for(_fly_with_mavsdk(bound.replace("tcp:", "tcpout://")), 90))
    assert 6 < height_m < 10
