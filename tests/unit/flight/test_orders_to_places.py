"""Orders to places: how each autopilot takes them, in flight, as a script, and read back from a log."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from log_bytes import KINDS, ardupilot_flight
from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.contract.standalone import Evidence
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase
from saflite.flight.autopilots.ardupilot.inputs import MODE_NUMBERS
from saflite.flight.autopilots.ardupilot.standalone.export import files_of
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.inputs import Inputs
from saflite.flight.autopilots.external.link import SimulatedClock
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.logs.dataflash import _commands
from saflite.flight.logs.dataflash_rows import load
from saflite.flight.mavlink.client import ARDUPILOT, PX4, Client
from saflite.oracle.orders import cuts_motors

LISTING = Listing(binary="0" * 64, parameters={})
PLACE = (0.0, 1.0, 0.0, 0.0, 47.3982, 8.5461637, 30.0)
NAMES = ("MAV_CMD_DO_SET_HOME", "MAV_CMD_DO_REPOSITION", "MAV_CMD_DO_SET_ROI_LOCATION", "MAV_CMD_DO_SET_ROI")
RELATIVE = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT


class Peer:
    """An autopilot of a kind that says its heartbeat and keeps what it is told."""

    name = "peer"

    def __init__(self, autopilot: int) -> None:
        vehicle = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._beat = bytes(vehicle.heartbeat_encode(2, autopilot, 0, 0, 4).pack(vehicle))
        self._reader, self.told = dialect.MAVLink(None), list[Any]()

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        self.told += self._reader.parse_buffer(data) or []
        return self._beat

    def close(self) -> None:
        pass

    def orders(self) -> list[Any]:
        return [one for one in self.told if one.get_type().startswith("COMMAND_")]


def linked(peer: Peer) -> tuple[Client, Vehicle]:
    vehicle = Vehicle(np.zeros((0, 8)), 0.0)
    client = Client(SimulatedClock(vehicle), peer)
    assert client.wait_for_heartbeat(1.0)
    return client, vehicle


def given(autopilot: int, name: str, values: Sequence[float]) -> Any:
    """Return the message by which a test case's command reaches an autopilot."""
    peer = Peer(autopilot)
    client, _ = linked(peer)
    stimuli = (Stimulus(at_s=0.0, kind="command", name=name, values=tuple(values)),)
    Inputs(client, [1500] * 4, stimuli, LISTING, MODE_NUMBERS).give_due(0.0)
    client.poll()
    (order,) = peer.orders()
    return order


@pytest.mark.parametrize("name", NAMES)
def test_ardupilot_gets_a_place_with_the_frame_of_its_height(name: str) -> None:
    """As COMMAND_LONG it refuses DO_REPOSITION; MAVLink has COMMAND_INT for places."""
    order = given(ARDUPILOT, name, PLACE)
    assert (order.get_type(), order.frame) == ("COMMAND_INT", RELATIVE)
    assert (order.param1, order.param2, order.x, order.y, order.z) == (0.0, 1.0, 473_982_000, 85_461_637, 30.0)


@pytest.mark.parametrize("name", NAMES)
def test_px4_gets_the_numbers_as_they_are(name: str) -> None:
    order = given(PX4, name, PLACE)
    assert order.get_type() == "COMMAND_LONG"
    assert (order.param5, order.param7) == (pytest.approx(47.3982, abs=1e-5), 30.0)


@pytest.mark.parametrize("name", ["MAV_CMD_NAV_TAKEOFF", "MAV_CMD_CONDITION_YAW", "MAV_CMD_DO_CHANGE_SPEED"])
def test_what_ardupilot_takes_without_a_place_stays_as_it_was(name: str) -> None:
    assert given(ARDUPILOT, name, (0, 0, 0, 0, 0, 0, 20)).get_type() == "COMMAND_LONG"


@pytest.mark.parametrize(("lat_deg", "x"), [(3e30, 2**31 - 1), (-3e30, -(2**31 - 1)), (math.nan, 0)])
def test_no_latitude_ends_the_link(lat_deg: float, x: int) -> None:
    assert given(ARDUPILOT, "MAV_CMD_DO_REPOSITION", (*PLACE[:4], lat_deg, *PLACE[5:])).x == x


def test_a_place_that_is_repeated_until_answered_goes_the_same_way() -> None:
    peer = Peer(ARDUPILOT)
    client, _ = linked(peer)
    client.send_command(dialect.MAV_CMD_DO_REPOSITION, PLACE, confirmation=2)
    client.poll()
    assert [one.get_type() for one in peer.orders()] == ["COMMAND_INT"]


@pytest.mark.parametrize("name", NAMES)
def test_the_script_gives_what_the_farm_gave(name: str) -> None:
    order = given(ARDUPILOT, name, PLACE)
    case = TestCase(
        target=Target(name="ardupilot"),
        scenario=Scenario(),
        stimuli=(Stimulus(at_s=1.0, kind="command", name=name, values=PLACE),),
    )
    flight = cast(Any, SimpleNamespace(ending="completed"))
    told = Evidence("finding.py", "a-guided1", "flies there", 6.0, 8.0, {}, [])
    files = files_of(case, flight, told, Binary(Path("arducopter"), "ab" * 32, "ArduCopter V4.5.7"), LISTING)
    for file in ("finding.py", "finding-autotest.py"):
        facts = json.loads(files[file].partition('json.loads(r"""')[2].partition('""")')[0])
        (what,) = facts["inputs"]
        sent = dialect.MAVLink_command_int_message(1, 1, *what["placed"])
        assert sent.pack(dialect.MAVLink(None)) == order.pack(dialect.MAVLink(None))


def test_an_auxiliary_function_in_a_log_is_an_order(tmp_path: Path) -> None:
    """It may be the emergency stop."""
    kinds, path = {**KINDS, "MAVC": ("QHff", "TimeUS,Cmd,P1,P2")}, tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight(kinds, more=[("MAVC", (3_000_000, 218, 31.0, 2.0))]))
    (order,) = _commands(load(path)[0])
    assert cuts_motors(order)


@pytest.mark.parametrize("name", ["MAV_CMD_DO_SET_HOME", "MAV_CMD_DO_REPOSITION"])
def test_a_place_in_a_log_is_in_degrees_again(name: str, tmp_path: Path) -> None:
    number = getattr(dialect, name)
    letters, columns = "QHffffiif", "TimeUS,Cmd,P1,P2,P3,P4,X,Y,Z"
    kinds, path = {**KINDS, "MAVC": (letters, columns)}, tmp_path / "flight.bin"
    row = (3_000_000, number, *PLACE[:4], 473_982_000, 85_461_637, 30.0)
    path.write_bytes(ardupilot_flight(kinds, more=[("MAVC", row)]))
    (order,) = _commands(load(path)[0])
    assert order.name == name
    assert order.values == pytest.approx(PLACE)


@pytest.mark.parametrize(("result", "counts"), [(0, True), (5, True), (1, False), (2, False), (3, False), (4, False)])
def test_a_refused_command_in_a_log_orders_nothing(result: int, counts: bool, tmp_path: Path) -> None:
    kinds, path = {**KINDS, "MAVC": ("QHffB", "TimeUS,Cmd,P1,P2,Res")}, tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight(kinds, more=[("MAVC", (3_000_000, 218, 31.0, 2.0, result))]))
    assert [cuts_motors(order) for order in _commands(load(path)[0])] == [True] * counts
