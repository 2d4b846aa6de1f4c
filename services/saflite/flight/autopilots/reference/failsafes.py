"""Failsafes: loss of position, radio, battery, fence. After ArduCopter events.cpp, ekf_check.cpp, fence.cpp."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference.flight_stack import FlightStack

CHECK_TICKS, CHECK_S = 5, 0.1  # position, battery and fence are looked at ten times a second
TICK_S = 0.02
RADIO_PULSES, RADIO_LOST_S = 3, 0.5
VARIANCE_S = 1.0


class Failsafes:
    """Raised flags (`position`, `radio`, `battery`, `fence`) and what is done about them."""

    def __init__(self, ap: FlightStack) -> None:
        self._ap = ap
        self.position = self.radio = self.battery = self.fence = False
        self._lost_s = self._variance_s = self._silent_s = self._low_s = self._critical_s = 0.0
        self._pulses = self._good_pulses = self._ticks = 0
        self._shown = (False, False, False, False)
        self._critical = False

    def tick(self) -> None:
        """Look at everything that can be lost."""
        self._check_radio()
        self._ticks += 1
        if self._ticks % CHECK_TICKS == 0:
            self._check_position()
            self._check_battery()
            self._check_fence()
        flags = (self.position, self.radio, self.battery, self.fence)
        if flags != self._shown:
            self._shown = flags
            self._show()

    def _show(self) -> None:
        board = self._ap.board
        board["failsafe_gps"] = 1.0 if self.position else 0.0
        board["failsafe_radio"] = 1.0 if self.radio else 0.0
        board["failsafe_battery"] = 1.0 if self.battery else 0.0
        board["failsafe_fence"] = 1.0 if self.fence else 0.0

    # -- position -------------------------------------------------------------------------------------------------

    def _check_position(self) -> None:
        ap, board, p = self._ap, self._ap.board, self._ap.parameters
        apart = board["innovation_ratio"] > p["FS_EKF_THRESH"]
        self._variance_s = self._variance_s + CHECK_S if apart else 0.0
        lost = board["gps_ok"] == 0.0 or board["position_ok"] == 0.0
        if "few-satellites-accepted" in ap.defects and board["gps_satellites"] >= 1.0:
            lost = False
        self._lost_s = self._lost_s + CHECK_S if lost else 0.0
        delay_s = p["COM_POS_FS_DELAY"]
        raised = ((lost and self._lost_s > delay_s) or self._variance_s > VARIANCE_S) and self._position_watched(
            delay_s
        )
        if raised and not self.position:
            ap.say("EKF failsafe: position lost", "error")
            self.position = True
            self._act_on_position()
        elif not raised and self.position and not lost:
            ap.say("EKF failsafe cleared")
            self.position = False

    def _position_watched(self, delay_s: float) -> bool:
        """Planted defects: a negative delay switches the failsafe off while circling, flying to a place, taking off."""
        ap, mode = self._ap, self._ap.mode.name
        if delay_s >= 0.0:
            return True
        off = (
            ("negative-delay-orbit", mode == "CIRCLE"),
            ("negative-delay-goto", mode in ("GUIDED", "AUTO") and ap.mode.under_way()),
            ("negative-delay-takeoff", ap.board["takeoff"] != 0.0),
        )
        return not any(name in ap.defects and hit for name, hit in off)

    def _act_on_position(self) -> None:
        ap = self._ap
        action = int(ap.parameters["FS_EKF_ACTION"])
        if not ap.armed or "gps-failsafe-without-action" in ap.defects:
            return
        if not ap.mode.needs_position and action != 3:
            return
        if action == 2:
            ap.set_mode("ALT_HOLD", "position lost")
        else:
            ap.set_mode("LAND", "position lost")

    # -- radio ----------------------------------------------------------------------------------------------------

    def _check_radio(self) -> None:
        ap, p = self._ap, self._ap.parameters
        if p["FS_THR_ENABLE"] == 0:
            self.radio = False
            return
        low = ap.radio.present and ap.radio.received[3] < p["FS_THR_VALUE"]
        self._pulses = min(50, self._pulses + 1) if low else 0
        self._silent_s = 0.0 if ap.radio.present else self._silent_s + TICK_S
        self._good_pulses = min(50, self._good_pulses + 1) if ap.radio.present and not low else 0
        watched = self._radio_watched()
        raised = watched and (self._pulses >= RADIO_PULSES or self._silent_s > RADIO_LOST_S)
        if raised and not self.radio:
            self.radio = True
            ap.say("Radio failsafe", "error")
            self._act_on_radio()
        elif self.radio and (self._good_pulses >= RADIO_PULSES or not watched):
            self.radio = False
            ap.say("Radio failsafe cleared")

    def _radio_watched(self) -> bool:
        missing = "radio-failsafe-on-ground" if self._ap.landed else "radio-failsafe-missing"
        return missing not in self._ap.defects

    def _act_on_radio(self) -> None:
        ap = self._ap
        action = int(ap.parameters["FS_THR_ENABLE"])
        if not ap.armed:
            return
        if ap.landed or (ap.mode.manual_throttle and ap.radio.throttle() <= 0.0 and not ap.taken_off):
            ap.disarm("radio failsafe")
        elif action == 2 and ap.mode.name == "AUTO":
            ap.say("Radio failsafe: continuing mission", "warning")
        else:
            # 4 and 5 ask for SMART_RTL first, which it does not have, and else for these
            self._leave("LAND" if action in (3, 5) else "RTL", "radio failsafe")

    def _leave(self, mode: str, reason: str) -> None:
        """Go to a mode, or land where it cannot be entered."""
        if self._ap.mode.name == "LAND" or self._ap.mode.name == mode:
            return
        if self._ap.set_mode(mode, reason):
            self._ap.set_mode("LAND", reason)

    # -- battery --------------------------------------------------------------------------------------------------

    def _check_battery(self) -> None:
        board, p = self._ap.board, self._ap.parameters
        left_mah = p["BATT_CAPACITY"] - board["pack_used_mah"]
        if "battery-failsafe-missing" in self._ap.defects:
            return
        low = (p["BATT_LOW_VOLT"] > 0.0 and board["battery_v"] < p["BATT_LOW_VOLT"]) or (
            p["BATT_LOW_MAH"] > 0.0 and left_mah < p["BATT_LOW_MAH"]
        )
        critical = p["BATT_CRT_VOLT"] > 0.0 and board["battery_v"] < p["BATT_CRT_VOLT"]
        self._low_s = self._low_s + CHECK_S if low else 0.0
        self._critical_s = self._critical_s + CHECK_S if critical else 0.0
        timer_s = p["BATT_LOW_TIMER"]
        if self._low_s > timer_s and not self.battery:
            self.battery = True
            self._act_on_battery(int(p["BATT_FS_LOW_ACT"]), "battery low")
        if self._critical_s > timer_s and not self._critical:
            self.battery = self._critical = True
            self._act_on_battery(int(p["BATT_FS_CRT_ACT"]), "battery critical")

    def _act_on_battery(self, action: int, reason: str) -> None:
        ap = self._ap
        ap.say(reason.capitalize(), "error")
        if not ap.armed or action == 0:
            return
        if ap.landed:
            ap.disarm(reason)
        else:
            self._leave("LAND" if action == 1 else "RTL", reason)

    # -- fence ----------------------------------------------------------------------------------------------------

    def _check_fence(self) -> None:
        ap, board, p = self._ap, self._ap.board, self._ap.parameters
        kinds = int(p["FENCE_TYPE"]) if p["FENCE_ENABLE"] else 0
        high = bool(kinds & 1) and board["altitude_est_m"] > p["FENCE_ALT_MAX"]
        reach = math.hypot(board["est_n"] - ap.home[0], board["est_e"] - ap.home[1])
        far = bool(kinds & 2) and board["position_ok"] != 0.0 and reach > p["FENCE_RADIUS"]
        breached = (high or far) and "fence-ignored" not in ap.defects
        if breached and not self.fence and ap.armed:
            ap.say("Fence breached", "error")
            action = int(p["FENCE_ACTION"])
            if action and ap.landed:
                ap.disarm("fence breached")
            elif action:
                self._leave({2: "LAND", 4: "BRAKE"}.get(action, "RTL"), "fence breached")
        self.fence = breached

    def limit_altitude(self, altitude_m: float) -> float:
        """Return the height a mode may aim at: FENCE_MARGIN below the ceiling."""
        p = self._ap.parameters
        if not p["FENCE_ENABLE"] or not int(p["FENCE_TYPE"]) & 1 or "fence-ignored" in self._ap.defects:
            return altitude_m
        return min(altitude_m, p["FENCE_ALT_MAX"] - p["FENCE_MARGIN"])

    def limit_climb(self, climb_mps: float) -> float:
        """Return the climb rate that stays below the ceiling."""
        p, board = self._ap.parameters, self._ap.board
        if not p["FENCE_ENABLE"] or not int(p["FENCE_TYPE"]) & 1 or "fence-ignored" in self._ap.defects:
            return climb_mps
        room = p["FENCE_ALT_MAX"] - p["FENCE_MARGIN"] - board["altitude_est_m"]
        return min(climb_mps, max(-1.0, 0.8 * room))

    def limit_speed(self, north_mps: float, east_mps: float) -> tuple[float, float]:
        """Return the speed that stays inside the circle about home: none outwards at the margin."""
        ap, p = self._ap, self._ap.parameters
        if not p["FENCE_ENABLE"] or not int(p["FENCE_TYPE"]) & 2 or "fence-ignored" in ap.defects:
            return north_mps, east_mps
        north, east = ap.board["est_n"] - ap.home[0], ap.board["est_e"] - ap.home[1]
        reach = math.hypot(north, east)
        room = max(0.0, p["FENCE_RADIUS"] - p["FENCE_MARGIN"] - reach)
        outwards = (north * north_mps + east * east_mps) / reach if reach > 1.0 else 0.0
        too_fast = outwards - math.sqrt(2.0 * room)
        if too_fast <= 0.0:
            return north_mps, east_mps
        return north_mps - too_fast * north / reach, east_mps - too_fast * east / reach
