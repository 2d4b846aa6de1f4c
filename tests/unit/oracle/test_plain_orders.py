"""Orders whose numbers leave no doubt, and those that leave some."""

from __future__ import annotations

import math

import pytest

from saflite.contract.flight import Given
from saflite.contract.test_case import Stimulus, StimulusKind
from saflite.oracle import plain_orders
from saflite.oracle.plain_orders import PlainOrder

HOME = (47.3977419, 8.5455938)
NEAR = (HOME[0] + 0.001, HOME[1])
FAR = (HOME[0] + 0.1, HOME[1])


def codes(kind: StimulusKind, name: str, *values: float, origin: tuple[float, float] | None = HOME) -> list[int]:
    given = Given(Stimulus(at_s=2.0, kind=kind, name=name, values=values), "accepted")
    return [one.code for one in plain_orders.plain_orders([given], origin)]


@pytest.mark.parametrize(
    ("code", "name", "values"),
    [
        (plain_orders.ARM, "COMPONENT_ARM_DISARM", (1.0,)),
        (0, "COMPONENT_ARM_DISARM", (0.0,)),
        (0, "COMPONENT_ARM_DISARM", (1.0, 21196.0)),
        (plain_orders.TAKE_OFF, "NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, 10)),
        (0, "NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, 1000)),
        (0, "NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, math.nan)),
        (plain_orders.GO, "DO_REPOSITION", (-1, 0, 0, 0, *NEAR, 20)),
        (0, "DO_REPOSITION", (-1, 4, 0, 0, *NEAR, 20)),
        (0, "DO_REPOSITION", (-1, 0, 0, 0, *FAR, 20)),
        (0, "DO_REPOSITION", (-1, 0, 0, 0, 0, 0, 20)),
        (0, "DO_REPOSITION", (-1, 0, 0, 0, 190, 8, 20)),
        (plain_orders.TURN, "CONDITION_YAW", (90, 0, 1, 0)),
        (0, "CONDITION_YAW", (90, 5, 1, 0)),
        (0, "CONDITION_YAW", (400, 0, 1, 0)),
        (plain_orders.SPEED, "DO_CHANGE_SPEED", (1, 5)),
        (0, "DO_CHANGE_SPEED", (2, 5)),
        (0, "DO_CHANGE_SPEED", (1, 0)),
        (plain_orders.BEGIN, "MISSION_START", ()),
        (plain_orders.HOME, "DO_SET_HOME", (1,)),
        (plain_orders.HOME, "DO_SET_HOME", (0, 0, 0, 0, *NEAR, 0)),
        (0, "DO_SET_HOME", (0, 0, 0, 0, *FAR, 0)),
        (plain_orders.PAUSE, "DO_PAUSE_CONTINUE", (0,)),
        (0, "DO_PAUSE_CONTINUE", (2,)),
        (0, "DO_PARACHUTE", (2,)),
    ],
)
def test_numbers_decide(code: int, name: str, values: tuple[float, ...]) -> None:
    assert codes("command", f"MAV_CMD_{name}", *values) == [code] * bool(code)


def test_a_flip_is_ordered_as_a_mode() -> None:
    assert codes("mode", "flip") == [plain_orders.FLIP]
    assert codes("mode", "LAND") == codes("parameter", "RTL_ALT", 1.0) == []


def test_without_an_origin_nobody_knows_how_far_a_place_is() -> None:
    assert codes("command", "MAV_CMD_DO_REPOSITION", -1, 0, 0, 0, *NEAR, 20, origin=None) == []


def test_what_was_refused_is_told() -> None:
    order = Stimulus(at_s=2.0, kind="command", name="MAV_CMD_MISSION_START")
    told = plain_orders.plain_orders([Given(order, "denied")], HOME)
    assert told == [PlainOrder(2.0, plain_orders.BEGIN, refused=True)]
