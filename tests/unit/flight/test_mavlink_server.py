"""The MAVLink server without a socket: bytes in, bytes out; broken bytes; the tables it shows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from ground_station import Station, acknowledged, asked
from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.parameter_types import TYPES
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.flight.mavlink.ports import open_port
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG

ACCEPTED, DENIED, FAILED = dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_DENIED, dialect.MAV_RESULT_FAILED
HOME, ROUTE = (16, 47.0, 8.0, 400.0), (16, 47.3978, 8.5456, 6.0)


@pytest.fixture
def station(caplog: pytest.LogCaptureFixture) -> Iterator[Station]:
    """A station whose messages the server can all handle."""
    yield Station()
    assert [record.getMessage() for record in caplog.get_records("call")] == []


def kinds(messages: list[Any]) -> set[str]:
    return {message.get_type() for message in messages}


def test_streams_tell_what_a_ground_station_needs(station: Station) -> None:
    seen = kinds(station.run(60))
    needed = "HEARTBEAT SYS_STATUS ATTITUDE GLOBAL_POSITION_INT LOCAL_POSITION_NED VFR_HUD GPS_RAW_INT RC_CHANNELS"
    assert set(needed.split()) <= seen


def test_every_parameter_is_listed_once(station: Station) -> None:
    station.mav.param_request_list_send(1, 1)
    values = [m for m in station.run(30) if m.get_type() == "PARAM_VALUE"]
    assert [m.param_index for m in values] == list(range(len(parameter_table())))
    assert {m.param_id for m in values} == set(parameter_table())
    assert max(len(m.param_id) for m in values) <= 16


def test_parameter_out_of_range_keeps_its_value(station: Station) -> None:
    station.mav.param_set_send(1, 1, b"LAND_SPEED", 9000.0, 9)
    answer = [m for m in station.run(2) if m.get_type() == "PARAM_VALUE"]
    assert answer[0].param_value == 70.0


def test_arm_take_off_and_refusals(station: Station) -> None:
    assert station.order(22, 0, 0, 0, 0, 0, 0, 5) == dialect.MAV_RESULT_FAILED
    assert station.order(176, 1, 4) == dialect.MAV_RESULT_ACCEPTED
    assert station.order(400, 1) == dialect.MAV_RESULT_ACCEPTED
    assert station.order(22, 0, 0, 0, 0, 0, 0, 5) == dialect.MAV_RESULT_ACCEPTED
    assert station.order(12345) == dialect.MAV_RESULT_UNSUPPORTED
    station.run(300)
    assert station.session.flight.vehicle["altitude_m"] == pytest.approx(5.0, abs=0.5)
    station.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0b111111111000, 4, 0, -5, 0, 0, 0, 0, 0, 0, 0, 0)
    station.run(500)
    assert station.session.flight.vehicle["x_m"] == pytest.approx(4.0, abs=0.6)


def test_mission_comes_back_as_it_went_up(station: Station) -> None:
    rows = [(16, 47.0, 8.0, 400.0), (22, 0.0, 0.0, 5.0), (16, 47.3978, 8.5456, 6.0), (20, 0.0, 0.0, 0.0)]
    station.mav.mission_count_send(1, 1, len(rows))
    for index, (number, lat, lon, height) in enumerate(rows):
        asked = [m.seq for m in station.run(2) if m.get_type() == "MISSION_REQUEST_INT"]
        assert asked[-1] == index
        place = (round(lat * 1e7), round(lon * 1e7), height)
        station.mav.mission_item_int_send(1, 1, index, 3, number, 0, 1, 1, 2, 3, 4, *place)
    assert [m.type for m in station.run(2) if m.get_type() == "MISSION_ACK"] == [0]
    station.mav.mission_request_list_send(1, 1)
    assert [m.count for m in station.run(2) if m.get_type() == "MISSION_COUNT"] == [len(rows)]
    station.mav.mission_request_int_send(1, 1, 2)
    item = next(m for m in station.run(2) if m.get_type() == "MISSION_ITEM_INT")
    assert (item.command, item.x, item.y, item.z) == (16, 473978000, 85456000, 6.0)
    station.mav.mission_clear_all_send(1, 1)
    station.run(2)
    assert station.session.flight.autopilot.mission is None


def test_garbage_does_not_stop_it(station: Station) -> None:
    rng = np.random.default_rng(1)
    station.mav.param_set_send(1, 1, b"RTL_ALT", 900.0, 9)
    good = bytes(station.out)
    for _ in range(300):
        damaged = bytearray(good)
        damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        station.out = damaged + bytearray(rng.bytes(20))
        station.run()
    station.out = bytearray(good)
    station.run(3)
    assert station.session.flight.autopilot.parameters["RTL_ALT"] == 900.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_stop_neither_the_server_nor_the_vehicle(station: Station, bad: float) -> None:
    station.take_off()
    for number in (22, 115, 176, 178, 179, 185, 192, 201, 208, 400, 410, 510, 511, 512, 520, 31010):
        station.order(number, *[bad] * 7)
        station.mav.command_int_send(1, 1, 0, number, 0, 0, bad, bad, bad, bad, 2**31 - 1, -(2**31), bad)
    station.run(200)
    assert station.session.flight.autopilot.armed
    assert station.session.flight.vehicle["altitude_m"] == pytest.approx(5.0, abs=0.5)
    assert station.order(20) == ACCEPTED


def test_commands_lacking_a_number_they_need_are_refused(station: Station) -> None:
    assert station.order(176, math.nan, 4) == DENIED
    assert station.order(176, 1, 4) == station.order(400, 1) == ACCEPTED
    assert station.order(22, 0, 0, 0, 0, 0, 0, math.nan) == FAILED
    assert station.order(22, math.nan, 0, 0, math.nan, math.nan, math.nan, 5) == ACCEPTED
    station.run(300)
    assert station.order(178, 1, math.nan) == FAILED
    assert station.order(185, math.nan) == FAILED
    assert station.order(115, 90, 0, 0, math.nan) == DENIED
    station.order(17)
    assert station.order(192, -1, math.nan, 0, math.nan, 47.3978, 8.5456, 6) == DENIED


def test_set_point_off_the_globe_is_ignored(station: Station) -> None:
    station.take_off()
    mask, guided = 0b111111111000, station.session.flight.autopilot.mode
    before = guided.target  # type: ignore[attr-defined]
    for lat, lon in ((2**31 - 1, 85456000), (473978000, -(2**31))):
        station.mav.set_position_target_global_int_send(0, 1, 1, 6, mask, lat, lon, 5, 0, 0, 0, 0, 0, 0, 0, 0)
    station.run(2)
    assert guided.target == before  # type: ignore[attr-defined]


def test_message_that_cannot_be_handled_is_logged_and_the_link_goes_on(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    station = Station()
    monkeypatch.delattr(station.session.flight.autopilot, "radio")
    for _ in range(2):
        station.mav.rc_channels_override_send(1, 1, 1500, 1500, 1500, 1500, 0, 0, 0, 0)
    station.mav.param_set_send(1, 1, b"RTL_ALT", 900.0, 9)
    station.session.server.feed(bytes(station.out))
    assert station.session.flight.autopilot.parameters["RTL_ALT"] == 900.0
    assert [record.getMessage().split(":")[0] for record in caplog.records] == [
        "MAVLink message RC_CHANNELS_OVERRIDE cannot be handled"
    ]
    assert caplog.records[0].exc_info is not None


def test_messages_for_other_systems_are_ignored(station: Station) -> None:
    ap = station.session.flight.autopilot
    station.mav.command_long_send(42, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    station.mav.param_set_send(42, 1, b"RTL_ALT", 900.0, 9)
    station.mav.set_mode_send(42, 1, 4)
    station.mav.mission_count_send(42, 1, 3)
    station.mav.manual_control_send(42, 1000, 1000, 1000, 1000, 0)
    seen = kinds(station.run(2))
    assert not seen & {"COMMAND_ACK", "PARAM_VALUE", "MISSION_REQUEST_INT"}
    assert (ap.armed, ap.mode.name, ap.radio.sent[1]) == (False, "STABILIZE", 1500.0)
    for system, component in ((0, 0), (1, 0), (1, 99)):
        station.mav.param_request_read_send(system, component, b"RTL_ALT", -1)
        assert "PARAM_VALUE" in kinds(station.run(2))


def test_message_interval_is_set_told_and_set_back(station: Station) -> None:
    def told_and_counted() -> tuple[int, int]:
        station.mav.command_long_send(1, 1, 510, 0, 30, 0, 0, 0, 0, 0, 0)
        told = next(m for m in station.run(2) if m.get_type() == "MESSAGE_INTERVAL")
        assert told.message_id == 30
        return told.interval_us, [m.get_type() for m in station.run(100)].count("ATTITUDE")

    assert told_and_counted() == (100_000, 20)
    for wanted, expected in ((20_000, (20_000, 100)), (500_000, (500_000, 4)), (-1, (-1, 0)), (1, (20_000, 100))):
        assert station.order(511, 30, wanted) == ACCEPTED
        assert told_and_counted() == expected
    for refused in (-2, math.nan, math.inf):
        assert station.order(511, 30, refused) == DENIED
    assert station.order(511, 30, 0) == ACCEPTED
    assert told_and_counted() == (100_000, 20)
    assert station.order(511, 9999, 100_000) == station.order(510, 9999) == FAILED


def test_a_stream_is_sent_at_the_rate_asked_for_or_not_at_all(station: Station) -> None:
    def count(kind: str) -> int:
        return sum(1 for message in station.run(100) if message.get_type() == kind)

    station.run(1)
    station.mav.request_data_stream_send(1, 1, 10, 25, 1)
    assert count("ATTITUDE") == 50
    station.mav.request_data_stream_send(1, 1, 10, 0, 0)
    assert count("ATTITUDE") == 0
    station.mav.request_data_stream_send(1, 1, 0, 2, 1)
    assert (count("ATTITUDE"), count("VFR_HUD")) == (4, 4)


def test_a_mission_item_that_was_reached_is_told(station: Station) -> None:
    station.take_off()
    rows = [(16, HOME_LAT_DEG + 0.00005 * number, HOME_LON_DEG, 5.0) for number in range(4)]  # the first is home
    assert station.upload(*rows) == ACCEPTED
    assert station.order(176, 1, 3) == ACCEPTED
    told = [message.seq for message in station.run(3000) if message.get_type() == "MISSION_ITEM_REACHED"]
    assert told[:2] == [1, 2]


def test_messages_are_sent_when_asked_for(station: Station) -> None:
    assert not kinds(station.run(60)) & {"HOME_POSITION", "AUTOPILOT_VERSION"}
    for number, kind in ((242, "HOME_POSITION"), (148, "AUTOPILOT_VERSION"), (36, "SERVO_OUTPUT_RAW")):
        station.order(511, number, -1)
        station.mav.command_long_send(1, 1, 512, 0, number, 0, 0, 0, 0, 0, 0)
        assert kind in kinds(station.run())
    assert station.order(512, 9999) == FAILED


@pytest.mark.parametrize(
    ("place", "result"),
    [
        ((107.0, 8.5, 5.0), dialect.MAV_MISSION_INVALID_PARAM5_X),
        ((math.nan, 8.5, 5.0), dialect.MAV_MISSION_INVALID_PARAM5_X),
        ((47.4, -181.0, 5.0), dialect.MAV_MISSION_INVALID_PARAM6_Y),
        ((47.4, 8.5, math.nan), dialect.MAV_MISSION_INVALID_PARAM7),
        ((47.4, 8.5, math.inf), dialect.MAV_MISSION_INVALID_PARAM7),
        ((47.4, 8.5, -1e6), dialect.MAV_MISSION_INVALID_PARAM7),
    ],
)
def test_impossible_place_ends_an_upload(station: Station, place: tuple[float, float, float], result: int) -> None:
    assert station.upload(HOME, ROUTE) == ACCEPTED
    assert station.upload(HOME, (16, *place)) == result
    mission = station.session.flight.autopilot.mission
    assert mission is not None
    assert mission.items[0].params[6] == 6.0
    station.mav.mission_item_send(1, 1, 1, 3, 16, 0, 1, 0, 0, 0, 0, *ROUTE[1:])
    assert not kinds(station.run(2)) & {"MISSION_REQUEST_INT", "MISSION_ACK"}


def test_infinite_number_of_an_item_is_refused_and_nan_is_not_given(station: Station) -> None:
    for bad, result in ((math.inf, dialect.MAV_MISSION_INVALID_PARAM1), (math.nan, ACCEPTED)):
        station.mav.mission_count_send(1, 1, 1)
        station.mav.mission_item_int_send(1, 1, 0, 3, 115, 0, 1, bad, 0, 0, 0, 0, 0, 0)
        assert acknowledged(station.run(2)) == [result]
    assert station.upload(HOME, (20, 1e30, 0.0, 0.0)) == dialect.MAV_MISSION_INVALID_PARAM5_X


def test_item_out_of_sequence_is_refused_and_a_repeat_is_not(station: Station) -> None:
    def send(index: int) -> list[Any]:
        station.mav.mission_item_send(1, 1, index, 3, 16, 0, 1, 0, 0, 0, 0, *ROUTE[1:])
        return station.run(2)

    station.mav.mission_count_send(1, 1, 3)
    assert asked(station.run(2)) == [0]
    wrong = send(2)
    assert (acknowledged(wrong), asked(wrong)) == ([dialect.MAV_MISSION_INVALID_SEQUENCE], [])
    assert asked(send(0)) == [1]
    repeated = send(0)
    assert (acknowledged(repeated), asked(repeated)) == ([], [1])
    assert asked(send(1)) == [2]
    assert acknowledged(send(0)) == [dialect.MAV_MISSION_INVALID_SEQUENCE]
    assert acknowledged(send(2)) == [dialect.MAV_MISSION_ACCEPTED]


def test_item_beyond_the_mission_being_flown_cannot_be_made_current(station: Station) -> None:
    assert station.upload(HOME, ROUTE) == ACCEPTED
    station.take_off()
    assert station.order(176, 1, 3) == ACCEPTED
    assert station.upload(HOME, ROUTE, ROUTE, ROUTE) == ACCEPTED
    station.mav.mission_set_current_send(1, 1, 3)
    assert acknowledged(station.run(2)) == [dialect.MAV_MISSION_INVALID_SEQUENCE]


def test_an_item_that_does_not_come_is_asked_for_again_and_then_given_up(station: Station) -> None:
    station.mav.mission_count_send(1, 1, 2)
    assert asked(station.run(260)) == [0] * 6  # at once, then once a second
    station.mav.mission_item_send(1, 1, 0, 3, 16, 0, 1, 0, 0, 0, 0, 47.0, 8.0, 400.0)
    messages = station.run(400)
    assert asked(messages) == [1] * 8
    assert acknowledged(messages) == [dialect.MAV_MISSION_OPERATION_CANCELLED]
    assert "Mission upload timeout" in {m.text for m in messages if m.get_type() == "STATUSTEXT"}
    assert station.upload(HOME, ROUTE) == 0


def test_whole_parameters_are_told_as_such_and_stay_so(station: Station) -> None:
    station.mav.param_request_list_send(1, 1)
    told = {m.param_id: m for m in station.run(40) if m.get_type() == "PARAM_VALUE"}
    assert told["FENCE_ENABLE"].param_type == dialect.MAV_PARAM_TYPE_INT8
    assert told["RTL_ALT"].param_type == dialect.MAV_PARAM_TYPE_INT16
    assert told["WPNAV_SPEED"].param_type == dialect.MAV_PARAM_TYPE_REAL32
    assert all(m.param_value == round(m.param_value) for m in told.values() if m.param_type != 9)
    assert set(TYPES) <= set(told)
    station.mav.param_set_send(1, 1, b"RTL_ALT", 900.4, dialect.MAV_PARAM_TYPE_REAL32)
    assert [m.param_value for m in station.run(2) if m.get_type() == "PARAM_VALUE"] == [900.0]


def test_a_fence_is_breached_only_where_it_is(station: Station) -> None:
    def fence() -> tuple[bool, bool]:
        last = next(m for m in reversed(station.run(100)) if m.get_type() == "SYS_STATUS")
        bit = dialect.MAV_SYS_STATUS_GEOFENCE
        return bool(last.onboard_control_sensors_enabled & bit), bool(last.onboard_control_sensors_health & bit)

    assert fence() == (False, True)  # or ground stations cry "fence breach" on connecting
    station.take_off()
    for name, value in ((b"FENCE_ACTION", 0.0), (b"FENCE_ENABLE", 1.0)):
        station.mav.param_set_send(1, 1, name, value, 9)
    assert fence() == (True, True)
    station.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0xDF8, 0, 0, -20.0, 0, 0, 0, 0, 0, 0, 0, 0)
    station.run(600)
    station.mav.param_set_send(1, 1, b"FENCE_ALT_MAX", 10.0, 9)
    assert fence() == (True, False)


def test_reboot_starts_anew(station: Station) -> None:
    station.mav.param_set_send(1, 1, b"RTL_ALT", 900.0, 9)
    station.run(2)
    first = station.session.flight
    assert station.order(246, 1) == dialect.MAV_RESULT_ACCEPTED
    assert station.session.flight is not first


def test_malformed_endpoints_are_refused() -> None:
    for endpoint in ("", "tcp:5760", "serial:/dev/x", "tcp:host:port", "udp:127.0.0.1:99999"):
        with pytest.raises(Refused, match="endpoint"):
            open_port(endpoint)
