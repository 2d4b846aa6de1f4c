"""From a flight's record to the signals that policies read: what the trace holds and what can be made of the rest.

Signals about stimuli (`quiet_s`, `gps_true`, ...) go by what was delivered, not by what was planned: a late stimulus
counts from when it was given, a denied or timed-out one not at all. Where a flight does not tell, the plan stands.

What holds at the sample of time t at which a stimulus is given (a target reads its inputs, goes on, then writes the
next sample):

* signals of state (`mode`, `armed`, settings) show what held just before it; what it did shows at the next sample;
* events (`rise`, `fall`) are seen at the first sample after them, with `prev` for what held just before;
* what is made of stimuli (`quiet_s`, `gps_true`, ...) counts it from the sample at t on, so before anything it causes.

Stimuli of one instant take effect in the order of the test case, before the autopilot goes on by itself; what held
between them is shown by moments of their own (`moments.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Flight, Trace, given
from saflite.contract.signals import MADE_FROM, can_show, lacking
from saflite.contract.test_case import Stimulus, StimulusKind, TestCase
from saflite.flight.autopilots.described import setting_ranges
from saflite.flight.geometry import boxes_array, distance_to_boxes
from saflite.oracle import itinerary, orders
from saflite.oracle.effects import FLAGS, undisturbed
from saflite.oracle.headings import Heading, headings
from saflite.oracle.moments import moments_of, samples_of
from saflite.oracle.orders import NEVER_S, SETTINGS
from saflite.oracle.plain_orders import PlainOrder, plain_orders
from saflite.oracle.settling import braking_mps2, least_ahead, settling

Array = NDArray[np.float32]
LEEWAY_DEG = 3.0
NO_HEIGHT_M = 1e6  # where the autopilot has no such height
STIMULI: tuple[str, ...] = get_args(StimulusKind)
ESTIMATES = {"x_est_m": "x_m", "y_est_m": "y_m", "altitude_est_m": "altitude_m", "climb_est_mps": "climb_mps"}
"""Logs of real autopilots hold estimates only, so the estimate stands for the truth and the other way round."""
_ALSO = {**ESTIMATES, "above_ground_m": "altitude_m"}
_TOLD_BY_LOGS = ("above_ground_m", "position_aided")  # our own flights have level ground, and satellites alone
_INSTEAD_OF_0 = {
    "return_speed_set_mps": "cruise_speed_set_mps",
    "pilot_speed_down_set_mps": "pilot_speed_up_set_mps",
}

_SINCE: dict[str, Callable[[Stimulus], bool]] = {
    "home_quiet_s": orders.moves_home,
    "divert_order_s": orders.diverts,
    "start_order_s": orders.starts_mission,
    "climb_order_s": orders.sets_climb,
    "height_order_s": orders.sets_height,
}
"""Time since the last input of a kind; very long where there was none."""


class FlightSignals:
    """The signals of one flight by name; those the oracle makes itself are made on demand.

    Args:
        test_case: what was flown.
        flight: how it went; its `delivered` tells what was given.
        trace: the samples.
        is_log: what the trace does not hold is not known, least of all by a default or the test case's settings.
        untold: what is made of orders and not known either, as a log does not keep them.
        between: show what held between stimuli of one instant, too (`moments.py`); otherwise samples alone.
    """

    def __init__(
        self,
        test_case: TestCase,
        flight: Flight,
        trace: Trace,
        *,
        between: bool = False,
        is_log: bool = False,
        untold: frozenset[str] = frozenset(),
    ) -> None:
        self._test_case, self._flight, self._trace = test_case, flight, trace
        self.moments = moments_of(trace, flight.delivered) if between else samples_of(trace)
        everything = given(test_case.stimuli, flight.delivered)
        self._given = tuple(one for one in everything if one.is_cause)
        self._asked = tuple(one for one in everything if one.answer != "timed_out")
        self._is_log, self._orders_untold = is_log, untold
        self._made: dict[str, Array] = {}
        self.samples, self.step_s, self.written = len(self.moments.row), trace.step_s, frozenset(trace.signals)
        self._makers: dict[str, Callable[[], Any]] = {
            "time_s": self._time,
            "quiet_s": lambda: self._quiet(STIMULI),
            "order_quiet_s": lambda: self._quiet(("command", "mode", "stick")),
            "command_quiet_s": lambda: self._quiet(("command",), never_s=-NEVER_S),
            "calm_s": lambda: self._since(orders.moves),
            **{name: partial(self._since, said, never_s=-NEVER_S) for name, said in _SINCE.items()},
            **{name: partial(self._undisturbed, name) for name in FLAGS},
            "crashed": self._crashed,
            "stop_ordered": lambda: self._ordered_from(orders.stops_motors),
            "arming_forced": lambda: self._ordered_from(orders.forces_arming),
            **{name: partial(self._setting, name) for name in SETTINGS},
            "release_order_s": lambda: self._since_asked(orders.releases),
            "stop_order_s": lambda: self._since_asked(orders.asks_to_stop),
            "mode_order_s": lambda: self._since_asked(lambda one: orders.mode_ordered(one) is not None),
            "mode_cause_s": lambda: self._since(orders.may_change_mode),
            **{f"rc{channel}_sent_pwm": partial(self._sent, f"RC{channel}") for channel in (1, 2, 3, 4)},
            "plain_order_s": lambda: orders.since([one.at_s for one in self._plain_orders()], self._time(), -NEVER_S),
            **{name: partial(self._last_plain_order, name) for name in ("plain_order", "plain_order_refused")},
            "ordered_mode": self._ordered_mode,
            "takeoff_slow_set_m": lambda: np.full_like(self._time(), NO_HEIGHT_M),
            **dict.fromkeys(("fs_action_delay_set_s", "position_aided"), lambda: np.zeros_like(self._time())),
            "ordered_home_m": self._ordered_home,
            "place_order_s": lambda: orders.since([one.at_s for one in self._places()], self._time(), -NEVER_S),
            "pause_order_s": lambda: orders.paused(self._given, self._time()),
            **{name: partial(self._of_item, name) for name in itinerary.NAMES},
            **{f"ordered_{part}": partial(self._last_place, part) for part in ("x_m", "y_m", "altitude_m")},
            "yaw_order_s": lambda: orders.since([one.at_s for one in self._headings()], self._time(), -NEVER_S),
            **{f"ordered_yaw_{part}": partial(self._last_heading, part) for part in ("deg", "way")},
            "ground_speed_mps": lambda: np.hypot(self["vx_mps"], self["vy_mps"]),
            **{name: partial(self._settling, name) for name in ("stopping_s", "settling_s")},
            "forward_mps": lambda: self._along(0.0),
            "right_mps": lambda: self._along(90.0),
            "home_distance_m": lambda: np.hypot(self["x_m"], self["y_m"]),
            "tilt_deg": self._tilt,
            **{name: partial(self.__getitem__, true) for name, true in _ALSO.items()},
            "obstacle_distance_m": self._obstacle_distance,
        }
        assert self._makers.keys() == MADE_FROM.keys(), "the table of what is made does not name its makers"

    def __contains__(self, name: str) -> bool:
        return can_show(name, self.written) and not (self._is_log and self._untold(name))

    def lacking(self, name: str) -> tuple[str, ...]:
        """Return the signals that would have to be written for `name` to be known; itself if it is made of orders."""
        return lacking(name, self.written) or ((name,) if name not in self else ())

    def __getitem__(self, name: str) -> Array:
        """Return one signal, shape (moments,); raises Refused if the trace cannot give it."""
        if name in self._made:
            return self._made[name]
        if name in self._trace.signals or name not in self._makers:
            made = self.moments.held(name, self._trace.array(name)[: self._trace.samples])
            made = self._with_orders(name, made)
        else:
            made = np.asarray(self._makers[name](), dtype=np.float32)
        self._made[name] = made
        return made

    def _with_orders(self, name: str, written: Array) -> Array:
        """What was written, or what was ordered by command where that is more.

        Targets write the speed set, and an order counts longer in some; logs write who stopped the motors by a switch,
        and where the estimate leapt by itself, so that a stimulus is not the only excuse.
        """
        if name in FLAGS:
            return np.minimum(written, self._undisturbed(name)).astype(np.float32)
        if name == "cruise_speed_set_mps":
            ordered = orders.speed_ordered(self._given, written.astype(np.float64), self._time())
        elif name == "stop_ordered":
            ordered = self._ordered_from(orders.stops_motors)
        else:
            return written
        return np.maximum(written, ordered).astype(np.float32)

    def pick(self, names: frozenset[str]) -> dict[str, Array]:
        """Return those of `names` that the flight can give."""
        return {name: self[name] for name in sorted(names) if name in self}

    def points(self) -> NDArray[np.float64]:
        """Return the track, shape (samples, 3): x, y, altitude in metres."""
        return np.stack([self["x_m"], self["y_m"], self["altitude_m"]], axis=1).astype(np.float64)

    def _untold(self, name: str) -> bool:
        """Say whether a log does not tell a signal known of our own flights: settings, terrain, obstacles, orders."""
        if name == "obstacle_distance_m":
            return not self._test_case.scenario.obstacles
        if name in ("stopping_s", "settling_s"):
            return any(self._untold(one) for one in ("acceleration_set_mps2", "angle_max_set_deg"))
        return (
            name in SETTINGS or name in ("crashed", *_TOLD_BY_LOGS, *itinerary.NAMES, *self._orders_untold)
        ) and name not in self.written

    def _time(self) -> NDArray[np.float64]:
        return self.moments.time_s

    def _causes(self) -> list[Stimulus]:
        return [one.stimulus for one in self._given]

    def _quiet(self, kinds: tuple[str, ...], *, never_s: float = 0.0) -> NDArray[np.float64]:
        return self._since(lambda one: one.kind in kinds, never_s=never_s)

    def _since(self, wanted: Callable[[Stimulus], bool], *, never_s: float = 0.0) -> NDArray[np.float64]:
        return orders.since([one.at_s for one in self._causes() if wanted(one)], self._time(), never_s)

    def _since_asked(self, wanted: Callable[[Stimulus], bool]) -> NDArray[np.float64]:
        """Time since an order of a kind, also of one that was denied."""
        return orders.since([one.at_s for one, _, _ in self._asked if wanted(one)], self._time(), -NEVER_S)

    def _sent(self, stick: str) -> NDArray[np.float64]:
        put = [one for one in self._causes() if one.kind == "stick" and one.name == stick and one.values]
        return orders.held([(one.at_s, one.values[0]) for one in put], self._time())

    def _plain_orders(self) -> list[PlainOrder]:
        return plain_orders(self._asked, orders.origin_of(self._test_case))

    def _last_plain_order(self, name: str) -> NDArray[np.float64]:
        part = "code" if name == "plain_order" else "refused"
        return orders.held([(one.at_s, float(getattr(one, part))) for one in self._plain_orders()], self._time())

    def _ordered_mode(self) -> NDArray[np.float64]:
        numbers = [(one.at_s, orders.mode_ordered(one)) for one, _, _ in self._asked]
        return orders.held([(at_s, float(number)) for at_s, number in numbers if number is not None], self._time())

    def _ordered_home(self) -> NDArray[np.float64]:
        track = (self["x_est_m"], self["y_est_m"], self["armed"])
        return orders.home_off(self._test_case, self._given, track, self._time())

    def _undisturbed(self, flag: str) -> NDArray[np.float64]:
        target = self._test_case.target
        calm = undisturbed(flag, self._causes(), target.parameters, self._time(), setting_ranges(target.name))
        if flag != "body_true":
            return calm
        return calm * (self._leeway_deg() >= LEEWAY_DEG) * (1.0 - self._ordered_from(orders.cuts_motors))

    def _leeway_deg(self) -> NDArray[np.float64]:
        """How far it may lean against AHRS_TRIM, taken within its range: without any it cannot hold a place."""
        roll, pitch = SETTINGS["trim_roll_set_deg"], SETTINGS["trim_pitch_set_deg"]
        askew_deg = np.hypot(
            np.clip(self["trim_roll_set_deg"], roll.low * roll.unit, roll.high * roll.unit),
            np.clip(self["trim_pitch_set_deg"], pitch.low * pitch.unit, pitch.high * pitch.unit),
        )
        return np.asarray(self["angle_max_set_deg"] - askew_deg)

    def _ordered_from(self, wanted: Callable[[Stimulus], bool]) -> NDArray[np.float64]:
        first_s = min((one.at_s for one in self._causes() if wanted(one)), default=np.inf)
        return (self._time() >= first_s - self.step_s).astype(np.float64)

    def _setting(self, name: str) -> NDArray[np.float64]:
        """A setting in force; a speed set to 0 is another one, as the manual says of each."""
        own = orders.setting_over_time(name, self._test_case, self._given, self._time())
        if name == "cruise_speed_set_mps":
            return orders.speed_ordered(self._given, own, self._time())
        if name in _INSTEAD_OF_0:
            return np.where(own == 0.0, self[_INSTEAD_OF_0[name]], own)
        return own

    def _places(self) -> list[orders.Place]:
        return orders.places(self._test_case, self._given)

    def _last_place(self, part: str) -> NDArray[np.float64]:
        return orders.held([(one.at_s, getattr(one, part)) for one in self._places()], self._time())

    def _last_heading(self, part: str) -> NDArray[np.float64]:
        return orders.held([(one.at_s, getattr(one, part)) for one in self._headings()], self._time())

    def _headings(self) -> list[Heading]:
        track = (self["x_est_m"], self["y_est_m"], self["yaw_deg"])
        return headings(self._test_case, self._given, track, self._time())

    def _of_item(self, name: str) -> NDArray[np.float64]:
        items, item = itinerary.items_of(self._test_case.scenario.mission), self["mission_item"]
        if name == "item_command":
            return np.nan_to_num(itinerary.of_items(itinerary.commands_of(self._test_case.scenario.mission), item))
        if name == "item_heading_deg":
            return itinerary.headings(self._test_case.scenario.mission, item, self["yaw_deg"])
        if name == "item_wait_s":
            return np.nan_to_num(itinerary.of_items([one.wait_s for one in items], item))
        if name == "item_speed_mps":
            return itinerary.speeds(self._test_case.scenario.mission, item)
        if name == "item_off_m":
            return itinerary.off(items, item, self["x_est_m"], self["y_est_m"])
        if name == "item_landing_off_m":
            landings = itinerary.landings_of(self._test_case.scenario.mission)
            return itinerary.off(landings, item, self["x_m"], self["y_m"])
        if name == "item_height_off_m":
            return itinerary.height_off(items, item, self["altitude_est_m"])
        off = [self._off_item(one) for one in items]
        return itinerary.unexpected(items, item, self["mode"], off, itinerary.afresh(self._given), self._time())

    def _off_item(self, item: itinerary.Item) -> NDArray[np.float64]:
        """Return how far from an item the vehicle is; its height counts where no fence may keep it lower."""
        planar = np.hypot(self["x_est_m"] - item.x_m, self["y_est_m"] - item.y_m)
        unfenced = self["fence_enabled"] == 0.0 if "fence_enabled" in self else np.False_
        height = np.where(unfenced, np.abs(self["altitude_est_m"] - item.altitude_m), 0.0)
        return np.asarray(np.maximum(planar, height * (itinerary.NEAR_M / itinerary.LOW_M)))

    def _settling(self, name: str) -> NDArray[Any]:
        braking = braking_mps2(self["acceleration_set_mps2"], self._leeway_deg())
        return settling(self["ground_speed_mps"], self["tilt_deg"], least_ahead(braking, self._time()))[name]

    def _crashed(self) -> Array:
        flags = np.zeros(self.samples, dtype=np.float32)
        if self._flight.ending == "crashed":
            flags[-1:] = 1.0
        return flags

    def _along(self, off_deg: float) -> NDArray[np.float64]:
        way_rad = np.radians(self["yaw_deg"] + off_deg)
        return np.asarray(self["vx_mps"] * np.cos(way_rad) + self["vy_mps"] * np.sin(way_rad))

    def _tilt(self) -> NDArray[np.float64]:
        upright = np.cos(np.radians(self["roll_deg"])) * np.cos(np.radians(self["pitch_deg"]))
        return np.asarray(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))

    def _obstacle_distance(self) -> NDArray[np.float64]:
        return distance_to_boxes(self.points(), boxes_array(self._test_case.scenario.obstacles))
