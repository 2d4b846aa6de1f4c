"""AUTO: fly the mission on board. After ArduCopter mode_auto.cpp and AP_Mission.cpp.

With OA_TYPE 1 the local planner lays the set-points between way-points, and way-points are accepted as PX4 does with
obstacle avoidance: within WPNAV_RADIUS, or once the vehicle is past them.
"""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference import settings, steer
from saflite.flight.autopilots.reference.avoidance import Point
from saflite.flight.autopilots.reference.mission_items import Item, understand
from saflite.flight.autopilots.reference.modes.base import TICK_S, Mode
from saflite.flight.autopilots.reference.modes.land import descend

LEGS = ("waypoint", "loiter", "land")
TURNED_COS = math.cos(math.radians(5.0))
PLAN_EVERY_TICKS = 5  # 10 Hz
FOLLOW_EVERY_TICKS = 2  # 25 Hz
HEIGHT_M, BRAKE_MPS = 0.5, 0.5
MOVED_M = 1.0  # off where a place was held last: a vehicle that stands there only has an estimate that shakes
HEIGHT_STALL_S, STALL_M = 20.0, 0.1  # the planner tries again after 15 s at rest; a hover shakes by 2 mm a tick
POSITION_P, HEIGHT_P = 0.95, 1.0  # MPC_XY_P, MPC_Z_P: the gains PX4 flies avoidance set-points with


class Auto(Mode):
    """The mission, item by item."""

    name = "AUTO"
    autonomous = True
    needs_position = True

    def __init__(self, *args: object) -> None:
        super().__init__(*args)  # type: ignore[arg-type]
        self._items: tuple[Item, ...] = ()
        self._goal: Point = (0.0, 0.0, 0.0)
        self._previous: Point = (0.0, 0.0, 0.0)
        self._ticks = 0
        self._since_s = 0.0
        self._height_gap, self._height_stalled_s = 1e9, 0.0
        self._reached = False
        self._jumps: dict[int, int] = {}
        self._set_point: tuple[float, float, float, float] | None = None
        self._trajectory: list[float] = []
        self._paused: Point | None = None
        self.done = False
        self._pilot_turns = False
        self._yaw_asked = False  # by an item that no leg was begun after
        self._speed_mps: float | None = None
        self._speed_before_mps: float | None = None

    def why_not(self) -> str:
        """A mission must be on board."""
        if self.ap.mission is None or not self.ap.mission.items:
            return "no mission"
        return super().why_not()

    def enter(self, previous: Mode) -> None:
        """Begin where the mission was left, nose along its legs: orders to turn given before do not count any more."""
        assert self.ap.mission is not None
        self.ap.yaw_order_rad, self._yaw_asked = None, False
        self._items = understand(self.ap.mission)
        self._goal = self._here()
        self._begin(min(self.ap.mission_index, len(self._items) - 1))

    def leave(self) -> None:
        """Let go of the speed that an item asked for: it is of the mission, other modes fly as fast as was set."""
        if self._speed_mps is not None and self.ap.speed_order_mps == self._speed_mps:
            self.ap.speed_order_mps = self._speed_before_mps

    def may_disarm(self) -> bool:
        """Only once the mission is over."""
        return self.done

    def disarms_on_landing(self) -> bool:
        """A mission that lands ends with motors off; one that returns stays where it stands until it has flown."""
        kind = self._item().kind
        return kind == "land" or (kind == "return" and self.ap.taken_off)

    def under_way(self) -> bool:
        """Between way-points."""
        return self._item().kind == "waypoint" and not self._reached

    def pause(self) -> None:
        """Hold here (DO_PAUSE_CONTINUE 0)."""
        self._paused = self._here()

    def resume(self) -> None:
        """Go on with the mission (DO_PAUSE_CONTINUE 1)."""
        self._paused = None

    def jump(self, index: int) -> bool:
        """Go on with item `index`, also of a mission that is over or paused; return whether there is one."""
        if not 0 <= index < len(self._items):
            return False
        self._paused, self.done, self._jumps = None, False, {}
        self._begin(index)
        return True

    def run(self) -> None:
        """Fly the item at hand."""
        if not self.ap.armed:
            self.stay_on_ground()
            return
        self.pilot_turn()
        if self._paused is not None:
            self._stay(self._paused)
        else:
            getattr(self, f"_{self._item().kind}")()
        turned = self._pilot_turns or self._item().kind == "delay"  # who waits turns to where the item before it said
        if turned and self.ap.yaw_order_rad is not None and self.ap.mode is self:
            steer.heading(self.board, self.ap.yaw_order_rad)  # items that turn nowhere leave the nose to the pilot, too

    def pilot_turn(self) -> None:
        """The pilot's yaw stick works in AUTO too; let go, the nose turns back to where the mission wants it."""
        rate = self.ap.radio.deflection(4)
        if rate != 0.0 and not self.ap.landed:
            turn = 0.3 * rate * math.radians(self.ap.parameters["PILOT_Y_RATE"])
            self.ap.yaw_order_rad, self._pilot_turns = self.board["est_yaw"] + turn, True
        elif self._pilot_turns:
            self.ap.yaw_order_rad, self._pilot_turns = None, False

    # -- items ----------------------------------------------------------------------------------------------------

    def _item(self) -> Item:
        return self._items[self.ap.mission_index]

    def _here(self) -> Point:
        return self.board["est_n"], self.board["est_e"], self.board["altitude_est_m"]

    def _begin(self, index: int) -> None:
        self.ap.mission_index = index
        item = self._items[index]
        if item.place is not None:
            self._previous = self._goal
            north, east, height = item.place
            self._goal = (north, east, self._previous[2] if item.kind == "land" else height)
        self._since_s = self.ap.time_s
        self._height_gap, self._height_stalled_s, self._reached = 1e9, 0.0, False
        self._ticks = 0
        if item.kind in LEGS:
            self._keep_or_drop_the_heading()
        if item.kind == "takeoff":
            if not self.ap.landed:  # begun again in the air: from here, not from where a place was last held
                self.board.set(set_n=self.board["est_n"], set_e=self.board["est_e"])
            self.board.set(takeoff_altitude_set_m=self._goal[2], set_altitude=self.board["altitude_est_m"])

    def _keep_or_drop_the_heading(self) -> None:
        """A heading is of the leg begun after its item, or flown when it is ordered (`ModeAuto::wp_start`)."""
        if not self._yaw_asked and not self._pilot_turns:
            self.ap.yaw_order_rad = None
        self._yaw_asked = False

    def _next(self) -> None:
        if self.ap.mission_index + 1 < len(self._items):
            self._begin(self.ap.mission_index + 1)
        else:
            self.done = True
            self._paused = self._goal

    def _takeoff(self) -> None:
        board = self.board
        self.ap.lift()
        board["takeoff"] = 1.0
        if self.ap.landed and abs(board["est_e"] - board["set_e"]) > MOVED_M:
            board["set_e"] = board["est_e"]
        steer.position(board, board["est_n"] if self.ap.landed else self._place(), board["set_e"], 2.0)
        _, up, down = settings.speeds(self.ap)
        height = self.ap.failsafes.limit_altitude(self._goal[2])
        # the target runs ahead so that the climb does not slow down before the end, as PX4's smoothed take-off
        steer.altitude(board, height + 1.5, up, down)
        if board["altitude_est_m"] > height - HEIGHT_M:
            board["takeoff"] = 0.0
            self._goal = (board["set_n"], board["set_e"], height)
            steer.altitude(board, height, up, down)
            self._next()

    def _place(self) -> float:
        """Keep the take-off place once off the ground."""
        return self.board["set_n"]

    def _waypoint(self) -> None:
        self._travel()
        if self._reached or self._arrived():
            if not self._reached:
                self._reached, self._since_s = True, self.ap.time_s
            if self.ap.time_s - self._since_s >= self._item().hold_s:
                self._next()

    def _land(self) -> None:
        board = self.board
        if not self._reached:
            self._travel()
            if self._arrived():
                self._reached = True
                self._set_point = None
                board.set(set_n=board["est_n"] + 0.4 * board["est_vn"], set_e=board["est_e"] + 0.4 * board["est_ve"])
            return
        steer.position(board, board["set_n"], board["set_e"], 2.0)
        if math.hypot(board["est_vn"], board["est_ve"]) < BRAKE_MPS or board["altitude_est_m"] < self._goal[2] - 1.0:
            descend(self)
        else:
            steer.altitude(board, self._goal[2], 1.0, 1.0)

    def _return(self) -> None:
        self.ap.set_mode("RTL", "mission")

    def _loiter(self) -> None:
        self._travel()

    def _speed(self) -> None:
        if self._item().number >= settings.SPEED_LEAST_MPS:
            if self._speed_mps is None:
                self._speed_before_mps = self.ap.speed_order_mps
            self._speed_mps = self.ap.speed_order_mps = self._item().number
        self._next()

    def _yaw(self) -> None:
        turn = math.radians(self._item().number)
        self.ap.yaw_order_rad = self.board["est_yaw"] + turn if self._item().relative else turn
        self._yaw_asked = True
        self._next()

    def _delay(self) -> None:
        self._stay(self._goal if self._set_point is None else (*self._set_point[:2], self._goal[2]))
        if self.ap.time_s - self._since_s >= self._item().number:
            self._next()

    def _jump(self) -> None:
        item, index = self._item(), self.ap.mission_index
        done = self._jumps.get(index, 0)
        if 0 <= item.number < len(self._items) and (item.hold_s < 0 or done < item.hold_s):
            self._jumps[index] = done + 1
            self._begin(int(item.number))
        else:
            self._next()

    def _skip(self) -> None:
        self._next()

    # -- flying ---------------------------------------------------------------------------------------------------

    def _stay(self, place: Point) -> None:
        plane, up, down = settings.speeds(self.ap)
        steer.position(self.board, place[0], place[1], plane)
        steer.altitude(self.board, place[2], up, down)

    def _travel(self) -> None:
        plane, up, down = settings.speeds(self.ap)
        board, avoidance = self.board, self.ap.avoidance
        height = self.ap.failsafes.limit_altitude(self._goal[2])
        goal = (self._goal[0], self._goal[1], height)
        if avoidance is None:
            self._stay(goal)
            self._face(math.atan2(goal[1] - board["est_e"], goal[0] - board["est_n"]), goal)
            return
        if self._ticks % PLAN_EVERY_TICKS == 0 or self._set_point is None:
            self._set_point = avoidance.set_point(self.ap.time_s, goal, self._previous)
        if self._ticks % FOLLOW_EVERY_TICKS == 0 or not self._trajectory:
            self._trajectory = avoidance.follow(
                self.ap.time_s, self._set_point[:3], goal, self._previous, FOLLOW_EVERY_TICKS * TICK_S
            )
        self._ticks += 1
        yaw = self._set_point[3]
        north, east, up_m, speed_n, speed_e, climb = self._trajectory
        speed_n, speed_e = (
            speed_n + POSITION_P * (north - board["est_n"]),
            speed_e + POSITION_P * (east - board["est_e"]),
        )
        scale = min(1.0, plane / max(1e-6, math.hypot(speed_n, speed_e)))
        steer.velocity(board, speed_n * scale, speed_e * scale)
        steer.altitude(board, self.ap.failsafes.limit_altitude(up_m), up, down, climb)
        yaw = self._ordered_yaw(yaw)
        steer.heading(board, yaw)

    def _ordered_yaw(self, wanted: float) -> float:
        """Return the heading ordered, until it is reached; then the planner's, whose camera must look ahead."""
        order = self.ap.yaw_order_rad
        if order is None:
            return wanted
        if not self._pilot_turns and math.cos(order - self.board["est_yaw"]) > TURNED_COS:
            self.ap.yaw_order_rad = None
        return order

    def _face(self, heading_rad: float, goal: Point) -> None:
        if self.ap.yaw_order_rad is not None:
            steer.heading(self.board, self.ap.yaw_order_rad)
        elif math.hypot(goal[0] - self.board["est_n"], goal[1] - self.board["est_e"]) > 1.0:
            steer.heading(self.board, heading_rad)

    def _arrived(self) -> bool:
        """Within the radius or past the way-point, at its height or no longer coming nearer to it."""
        here = self._here()
        gap = abs(self._goal[2] - here[2])
        self._height_stalled_s += TICK_S
        if abs(gap - self._height_gap) > STALL_M:
            self._height_gap, self._height_stalled_s = gap, 0.0
        off = math.hypot(self._goal[0] - here[0], self._goal[1] - here[1])
        leg = (self._goal[0] - self._previous[0], self._goal[1] - self._previous[1])
        along = (here[0] - self._previous[0]) * leg[0] + (here[1] - self._previous[1]) * leg[1]
        length2 = leg[0] ** 2 + leg[1] ** 2
        near = off < self.ap.parameters["WPNAV_RADIUS"] / 100.0
        past = self.ap.avoidance is not None and length2 > 1e-6 and along > length2
        return (near or past) and (gap < HEIGHT_M or (near and self._height_stalled_s > HEIGHT_STALL_S))


MODE = Auto
