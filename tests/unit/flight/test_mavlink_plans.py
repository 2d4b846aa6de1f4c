"""Fences and rally points over MAVLink: up, down, cleared, and refused where they are none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest
from ground_station import Station

from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG

HOME, ROUTE = (16, 47.0, 8.0, 400.0), (16, 47.3978, 8.5456, 6.0)
CORNERS = [
    (5001, 3, HOME_LAT_DEG + north, HOME_LON_DEG + east) for north, east in ((0.001, 0), (0, 0.001), (0, -0.001))
]


@pytest.fixture
def station(caplog: pytest.LogCaptureFixture) -> Iterator[Station]:
    """A station whose messages the server can all handle."""
    yield Station()
    assert [record.getMessage() for record in caplog.get_records("call")] == []


def lay(station: Station, plan: int, rows: Sequence[tuple[int, float, float, float]]) -> int:
    """Upload points of a fence (1) or rally points (2) of (command, first number, latitude, longitude)."""
    station.mav.mission_count_send(1, 1, len(rows), plan)
    for index, (number, first, lat, lon) in enumerate(rows):
        requests = [m for m in station.run(2) if m.get_type() == "MISSION_REQUEST_INT"]
        assert [(m.seq, m.mission_type) for m in requests] == [(index, plan)]
        place = round(lat * 1e7), round(lon * 1e7), 30.0
        station.mav.mission_item_int_send(1, 1, index, 3, number, 0, 1, first, 0, 0, 0, *place, plan)
    acks = [m for m in station.run(2) if m.get_type() == "MISSION_ACK"]
    assert [m.mission_type for m in acks] == [plan]
    return int(acks[0].type)


def points(station: Station, plan: int) -> list[tuple[int, float, int, int]]:
    station.mav.mission_request_list_send(1, 1, plan)
    (count,) = [m.count for m in station.run(2) if m.get_type() == "MISSION_COUNT" and m.mission_type == plan]
    found = []
    for index in range(count):
        station.mav.mission_request_int_send(1, 1, index, plan)
        (item,) = [m for m in station.run(2) if m.get_type() == "MISSION_ITEM_INT"]
        assert (item.seq, item.mission_type, item.current) == (index, plan, 0)
        found.append((item.command, item.param1, item.x, item.y))
    return found


@pytest.mark.parametrize(
    ("plan", "rows"),
    [(1, [*CORNERS, (5004, 20, HOME_LAT_DEG, HOME_LON_DEG)]), (2, [(5100, 0, HOME_LAT_DEG, HOME_LON_DEG)])],
)
def test_fence_and_rally_points_come_back_as_they_went_up(
    station: Station, plan: int, rows: Sequence[tuple[int, float, float, float]]
) -> None:
    assert station.upload(HOME, ROUTE) == 0
    assert lay(station, plan, rows) == 0
    assert points(station, plan) == [(row[0], row[1], round(row[2] * 1e7), round(row[3] * 1e7)) for row in rows]
    assert any("not heeded" in text.text for text in station.session.flight.autopilot.messages)
    assert station.session.flight.autopilot.mission is not None, "another plan than the mission"
    station.mav.mission_clear_all_send(1, 1, plan)
    assert points(station, plan) == []
    assert station.session.flight.autopilot.mission is not None


@pytest.mark.parametrize(
    "rows",
    [
        CORNERS[:2],
        [CORNERS[0], (5002, *CORNERS[1][1:]), CORNERS[2]],
        [(5001, 2, *CORNERS[0][2:])] * 2,
        [(5003, 0, HOME_LAT_DEG, HOME_LON_DEG)],
        [(5100, 0, HOME_LAT_DEG, HOME_LON_DEG)],
        [(5003, 20, 91.0, HOME_LON_DEG)],
    ],
    ids=["corner missing", "kinds mixed", "two corners", "no radius", "rally point", "beyond the pole"],
)
def test_a_fence_that_is_none_leaves_the_one_before(
    station: Station, rows: Sequence[tuple[int, float, float, float]]
) -> None:
    assert lay(station, 1, CORNERS) == 0
    assert lay(station, 1, rows) != 0
    assert len(points(station, 1)) == 3


def test_everything_uploaded_is_cleared_at_once(station: Station) -> None:
    assert station.upload(HOME, ROUTE) == 0
    assert lay(station, 1, CORNERS) == 0
    station.mav.mission_clear_all_send(1, 1, 255)
    station.run(2)
    assert points(station, 1) == []
    assert station.session.flight.autopilot.mission is None
