"""Transfer of missions, fences and rally points over MAVLink: upload, download, clear, set current."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from saflite.contract.test_case import MissionItem
from saflite.flight.mavlink.items import PLACES, float_frame, whole
from saflite.flight.mavlink.plans import FENCE, MISSION, RALLY, KeptPlan, MissionPlan, Plan
from saflite.flight.mavlink.vehicle import LinkedVehicle

ACCEPTED, ERROR, UNSUPPORTED, NO_SPACE, INVALID_PARAM1, INVALID_SEQUENCE, CANCELLED = 0, 1, 3, 4, 6, 13, 15
ASK_AGAIN_TICKS, TIMEOUT_TICKS = 50, 400  # 1 s and 8 s, as ArduPilot has it
ITEMS_MAX = 700
ALL_KINDS = 255
REPOSITION = 192
PLACE_MAX = (90.0, 180.0, 83_000.0)  # degrees, degrees, ArduPilot's greatest altitude in metres
INT32_MAX = 2.0**31 - 1.0


class MissionTransfer:
    """One transfer at a time; `link` is a pymavlink `MAVLink`."""

    def __init__(self, vehicle: LinkedVehicle, link: Any) -> None:
        self._vehicle, self._link = vehicle, link
        self._plans: dict[int, Plan] = {
            MISSION: MissionPlan(vehicle),
            FENCE: KeptPlan(vehicle, FENCE),
            RALLY: KeptPlan(vehicle, RALLY),
        }
        self._expected, self._kind = 0, MISSION
        self._items: list[MissionItem] = []
        self._peer = (255, 190)
        self._silent_ticks = 0

    def handle(self, kind: str, message: Any) -> bool:
        """Take a message; return whether it was about missions."""
        handler = getattr(self, f"_{kind.lower()}", None) if kind.startswith("MISSION_") else None
        if handler is None:
            return False
        plan = getattr(message, "mission_type", MISSION)
        self._peer = (message.get_srcSystem(), message.get_srcComponent())
        if plan not in self._plans and not (plan == ALL_KINDS and kind == "MISSION_CLEAR_ALL"):
            self._ack(UNSUPPORTED, plan)
            return True
        handler(message)
        return True

    def tick(self) -> None:
        """Ask again for an item that does not come; give an upload up that stands still for 8 s."""
        if not self._expected:
            return
        self._silent_ticks += 1
        if self._silent_ticks >= TIMEOUT_TICKS:
            self._expected = 0
            self._vehicle.say("Mission upload timeout", "warning")
            self._ack(CANCELLED, self._kind)
        elif self._silent_ticks % ASK_AGAIN_TICKS == 0:
            self._ask(len(self._items))

    # -- upload ---------------------------------------------------------------------------------------------------

    def _mission_count(self, message: Any) -> None:
        if message.count > ITEMS_MAX:
            self._ack(NO_SPACE, message.mission_type)
            return
        self._kind = message.mission_type
        self._expected, self._items = message.count, []
        if message.count == 0:
            self._store()
        else:
            self._request(0)

    def _mission_item_int(self, message: Any) -> None:
        self._take(message, message.x / 1e7, message.y / 1e7)

    def _mission_item(self, message: Any) -> None:
        if message.current == 2:
            self._guided(message)
        else:
            self._take(message, message.x, message.y)

    def _take(self, message: Any, lat: float, lon: float) -> None:
        if self._expected == 0 or message.mission_type != self._kind:
            return
        asked = len(self._items)
        if message.seq == asked:
            self._add(message, lat, lon)
        elif message.seq == asked - 1:  # a repeat: the request for the next one was lost
            self._request(asked)
        else:
            self._ack(INVALID_SEQUENCE, self._kind)

    def _add(self, message: Any, lat: float, lon: float) -> None:
        """Take the item asked for; an impossible one ends the upload."""
        placed = message.command in PLACES
        last = (lat, lon, message.z) if placed else (message.x, message.y, message.z)
        numbers = (message.param1, message.param2, message.param3, message.param4, *last)
        is_taken = self._plans[self._kind].takes(message.command)
        result = _checked(message.command, numbers) if is_taken else UNSUPPORTED
        if result != ACCEPTED:
            self._expected = 0
            self._ack(result, self._kind)
            return
        params = tuple(None if math.isnan(value) else float(value) for value in numbers)
        self._items.append(MissionItem(command=message.command, frame=float_frame(message.frame), params=params))
        if len(self._items) < self._expected:
            self._request(len(self._items))
        else:
            self._store()

    def _store(self) -> None:
        """Put what was uploaded in the place of what was there."""
        self._expected = 0
        why = self._plans[self._kind].store(self._items)
        if why:
            self._vehicle.say(why[:50], "warning")
        self._ack(UNSUPPORTED if why else ACCEPTED, self._kind)

    def _guided(self, message: Any) -> None:
        """A way-point with `current` 2 is an order to go there in GUIDED (older ground stations)."""
        numbers = (-1.0, 1.0, 0.0, 0.0, message.x, message.y, message.z)
        self._ack(ACCEPTED if self._vehicle.execute(REPOSITION, numbers) == ACCEPTED else ERROR)

    # -- download and the rest ------------------------------------------------------------------------------------

    def _mission_request_list(self, message: Any) -> None:
        kind = message.mission_type
        self._link.mission_count_send(*self._peer, self._plans[kind].count, kind)

    def _mission_request_int(self, message: Any) -> None:
        self._send_item(message, self._link.mission_item_int_send, whole)

    def _mission_request(self, message: Any) -> None:
        self._send_item(message, self._link.mission_item_send, lambda command, value: value)

    def _send_item(self, message: Any, send: Callable[..., None], number: Callable[[int, float], float]) -> None:
        kind, plan = message.mission_type, self._plans[message.mission_type]
        item = plan.item(message.seq)
        if item is None:
            self._ack(INVALID_SEQUENCE, kind)
            return
        values = [math.nan if value is None else value for value in item.params]
        x, y = number(item.command, values[4]), number(item.command, values[5])
        current = int(message.seq == plan.current)
        send(*self._peer, message.seq, item.frame, item.command, current, 1, *values[:4], x, y, values[6], kind)

    def _mission_clear_all(self, message: Any) -> None:
        for kind, plan in self._plans.items():
            if message.mission_type in (kind, ALL_KINDS):
                plan.store(())
        self._ack(ACCEPTED, message.mission_type)

    def _mission_set_current(self, message: Any) -> None:
        if not self._vehicle.jump_to(max(0, message.seq - 1)):
            self._ack(INVALID_SEQUENCE)
            return
        self._link.mission_current_send(message.seq)

    def _mission_ack(self, message: Any) -> None:
        """The ground station has received a download."""

    def _request(self, index: int) -> None:
        self._silent_ticks = 0
        self._ask(index)

    def _ask(self, index: int) -> None:
        self._link.mission_request_int_send(*self._peer, index, self._kind)

    def _ack(self, result: int, mission_type: int = 0) -> None:
        self._link.mission_ack_send(*self._peer, result, mission_type)


def _checked(command: int, numbers: Sequence[float]) -> int:
    """Return ACCEPTED or which of an item's seven numbers is impossible; where there is no place NaN is "not given"."""
    placed = command in PLACES
    limits = (math.inf,) * 4 + (PLACE_MAX if placed else (INT32_MAX, INT32_MAX, math.inf))
    for index, (number, limit) in enumerate(zip(numbers, limits, strict=True)):
        missing = math.isnan(number) and placed and index >= 4
        if missing or math.isinf(number) or abs(number) > limit:
            return INVALID_PARAM1 + index
    return ACCEPTED
