"""The MAVLink client against the server over a link in memory, on the time of the simulation."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.reference.sitl import Session, on_the_ground
from saflite.flight.mavlink.client import Answer, Client
from saflite.flight.mavlink.ports import TcpClientPort, TcpPort
from saflite.flight.mission import builtin_mission

GUIDED, AUTO = 4, 3
ARM, TAKE_OFF, NOTHING = 400, 22, 12345


class Simulated:
    """A port that flies the reference 20 ms per exchange, and the clock that tells its time.

    `loses` says of every exchange, by its number, whether what was sent is lost.
    """

    name = "memory"

    def __init__(self, loses: Callable[[int], bool] = lambda number: False) -> None:
        self.session = Session(on_the_ground())
        self.loses, self.exchanges, self.sent = loses, 0, bytearray()

    def monotonic_s(self) -> float:
        return self.exchanges * 0.02

    def unix_s(self) -> float:
        return self.monotonic_s()

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        self.exchanges += 1
        self.sent += data
        self.session.feed(b"" if self.loses(self.exchanges) else data)
        return self.session.step()

    def close(self) -> None:
        pass

    def count(self, kind: str) -> int:
        """How often the client sent a kind of message."""
        return [m.get_type() for m in dialect.MAVLink(None).parse_buffer(self.sent) or []].count(kind)


class Silent(Simulated):
    """A vehicle that says nothing, or what it is told to."""

    def __init__(self, answers: Callable[[list[dialect.MAVLink_message]], bytes] = lambda messages: b"") -> None:
        self.exchanges, self.answers, self.reader = 0, answers, dialect.MAVLink(None)

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        self.exchanges += 1
        return self.answers(self.reader.parse_buffer(data) or [])


def connected(simulated: Simulated) -> Client:
    client = Client(simulated, simulated)
    assert client.wait_for_heartbeat(5.0)
    return client


def test_a_parameter_is_set_and_read_back() -> None:
    simulated = Simulated()
    client = connected(simulated)
    assert client.set_parameter("RTL_ALT", 900.0, 2.0)[:3] == ("accepted", None, 900.0)
    assert client.set_parameter("LAND_SPEED", 9000.0, 2.0)[:3] == ("denied", None, 70.0)
    assert client.set_parameter("NOBODY_HAS_IT", 1.0, 2.0).state == "timed_out"
    assert client.parameter("RTL_ALT", 2.0) == 900.0
    assert simulated.session.flight.autopilot.parameters["RTL_ALT"] == 900.0


def test_commands_and_modes_are_answered_and_fly() -> None:
    simulated = Simulated()
    client = connected(simulated)
    assert client.command(TAKE_OFF, (0, 0, 0, 0, 0, 0, 5), 2.0) == Answer("denied", dialect.MAV_RESULT_FAILED)
    assert client.command(NOTHING, (), 2.0) == Answer("denied", dialect.MAV_RESULT_UNSUPPORTED)
    assert client.set_mode(GUIDED, 3.0).ok
    assert client.set_mode(99, 3.0).state == "denied"
    assert client.command(ARM, (1,), 2.0).ok
    assert client.command(TAKE_OFF, (0, 0, 0, 0, 0, 0, 5), 2.0).ok
    up, _ = client.wait(lambda m: m.get_type() == "LOCAL_POSITION_NED" and m.z < -4.5, 20.0)
    assert up is not None
    assert "Arming motors" in client.texts
    assert client.latest["HEARTBEAT"].base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED


def test_orders_lost_on_the_way_are_repeated() -> None:
    simulated = Simulated()
    client = connected(simulated)
    until = simulated.exchanges + 60
    simulated.loses = lambda number: number < until
    answer = client.command(176, (1, GUIDED), 3.0)
    assert answer.ok
    assert answer.sends == 4
    assert simulated.monotonic_s() < until * 0.02 + 0.6


def test_deadlines_are_kept_when_nobody_answers() -> None:
    silent = Silent()
    client = Client(silent, silent)
    orders: tuple[Callable[[], Answer], ...] = (
        lambda: client.command(ARM, (1,), 2.0),
        lambda: client.set_parameter("RTL_ALT", 1.0, 2.0),
        lambda: client.set_mode(GUIDED, 2.0),
        lambda: client.upload(builtin_mission("mission2"), 2.0),
    )
    for order in orders:
        began_s = silent.monotonic_s()
        assert order().state == "timed_out"
        assert silent.monotonic_s() - began_s == pytest.approx(2.0, abs=0.05)
    assert not client.wait_for_heartbeat(0.5)


@pytest.mark.parametrize("every", [0, 3])
def test_a_mission_goes_up_though_messages_are_lost(every: int) -> None:
    simulated = Simulated()
    client = connected(simulated)
    simulated.loses = lambda number: every > 0 and number % every == 0
    mission = builtin_mission("mission2")
    assert client.upload(mission, 30.0).ok
    on_board = simulated.session.flight.autopilot.mission
    assert on_board is not None
    assert [item.command for item in on_board.items] == [item.command for item in mission.items]
    for have, want in zip(on_board.items, mission.items, strict=True):
        assert have.params == pytest.approx([value or 0.0 for value in want.params], abs=1e-5)
    assert client.set_mode(AUTO, 3.0).ok == client.command(ARM, (1,), 2.0).ok


def test_an_impossible_mission_is_denied_with_the_result() -> None:
    simulated = Simulated()
    client = connected(simulated)
    mission = builtin_mission("mission2")
    first = msgspec.structs.replace(mission.items[1], params=(0.0, 0.0, 0.0, 0.0, 99.0, 8.5, 5.0))
    bad = msgspec.structs.replace(mission, items=(mission.items[0], first))
    assert client.upload(bad, 5.0)[:2] == ("denied", dialect.MAV_MISSION_INVALID_PARAM5_X)


def test_sticks_are_refreshed_until_released_and_heartbeats_go_out() -> None:
    simulated = Simulated()
    client = connected(simulated)
    client.override({3: 1200.0})
    before = simulated.count("RC_CHANNELS_OVERRIDE"), simulated.count("HEARTBEAT")
    for _ in range(100):
        client.poll()
    after = simulated.count("RC_CHANNELS_OVERRIDE"), simulated.count("HEARTBEAT")
    assert (after[0] - before[0], after[1] - before[1]) == (10, 2)
    assert simulated.session.flight.autopilot.radio.sent == {1: 1500.0, 2: 1500.0, 3: 1200.0, 4: 1500.0}
    client.release()
    for _ in range(50):
        client.poll()
    assert simulated.count("RC_CHANNELS_OVERRIDE") == after[0] + 1


def test_every_link_is_drained() -> None:
    simulated, other = Simulated(), Simulated()
    client = Client(simulated, simulated, other)
    client.poll()
    client.poll()
    assert other.exchanges == 2
    assert other.count("HEARTBEAT") == 1


def test_work_in_progress_is_waited_for() -> None:
    vehicle = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    results = iter([dialect.MAV_RESULT_IN_PROGRESS, dialect.MAV_RESULT_ACCEPTED])

    def answers(messages: list[dialect.MAVLink_message]) -> bytes:
        asked = [m for m in messages if m.get_type() == "COMMAND_LONG"]
        return b"".join(vehicle.command_ack_encode(m.command, next(results)).pack(vehicle) for m in asked)

    silent = Silent(answers)
    assert Client(silent, silent).command(ARM, (1,), 3.0) == Answer("accepted", 0, sends=2)


def test_whole_numbers_of_px4_travel_as_bytes() -> None:
    vehicle = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    held = [5]

    def as_float() -> float:
        return float(struct.unpack("<f", struct.pack("<i", held[0]))[0])

    def answers(messages: list[dialect.MAVLink_message]) -> bytes:
        data = vehicle.heartbeat_encode(2, 12, 0, 0, 4).pack(vehicle)
        for m in messages:
            if m.get_type() == "PARAM_SET":
                assert m.param_type == dialect.MAV_PARAM_TYPE_INT32
                held[0] = struct.unpack("<i", struct.pack("<f", m.param_value))[0]
            if m.get_type() in ("PARAM_SET", "PARAM_REQUEST_READ"):
                data += vehicle.param_value_encode(b"NAV_RCL_ACT", as_float(), 6, 1, 0).pack(vehicle)
        return bytes(data)

    silent = Silent(answers)
    client = connected(silent)
    assert client.set_parameter("NAV_RCL_ACT", 2.0, 2.0)[:3] == ("accepted", None, 2.0)
    assert held == [2]
    assert not math.isclose(as_float(), 2.0)


def test_a_tcp_link_carries_both_ways_and_tells_when_the_peer_is_gone() -> None:
    server = TcpPort("127.0.0.1", 0)
    client = TcpClientPort("127.0.0.1", int(server.name.rsplit(":", 1)[1]))
    client.exchange(b"up", 0.0)
    received = b""
    while not received:
        received = server.exchange(b"", 1.0)
    server.exchange(b"down", 0.0)
    assert (received, client.exchange(b"", 5.0)) == (b"up", b"down")
    server.close()
    with pytest.raises(Unavailable, match="hung up"):
        client.exchange(b"", 5.0)
    client.close()
    with pytest.raises(Unavailable, match="refused"):
        TcpClientPort("127.0.0.1", int(server.name.rsplit(":", 1)[1]))
