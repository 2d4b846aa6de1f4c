"""The inputs that PX4 takes: commands, faults it makes itself when told to, faults of our sensors, motors and radio."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import msgspec

from saflite.contract.errors import Refused
from saflite.contract.flight import DeliveryAnswer
from saflite.contract.test_case import Stimulus
from saflite.flight.autopilots.external import inputs
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.modes import MODES, NUMBERS
from saflite.flight.autopilots.px4.places import placed
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client
from saflite.flight.sensors.faults import FAULTS, Fault

INJECT_FAILURE = 420
ALL = 0.0  # instances of a unit
OK, OFF, STUCK, WRONG = 0, 1, 2, 4  # FAILURE_TYPE
MOTORS = 4
EFFECT_S = 3.0  # simulated; a receiver counts as silent after two


class Injected(NamedTuple):
    """A fault that PX4 makes itself: FAILURE_UNIT and FAILURE_TYPE of MAV_CMD_INJECT_FAILURE."""

    unit: int
    type: int
    meaning: str


_UNITS = {"gyro": 0, "accelerometer": 1, "compass": 2, "baro": 3, "gps": 4}
INJECTED: dict[str, Injected] = {
    **{f"{name}_off": Injected(unit, OFF, f"PX4 takes nothing from its {name}") for name, unit in _UNITS.items()},
    **{f"{name}_stuck": Injected(unit, STUCK, f"PX4 repeats its {name}") for name, unit in _UNITS.items()},
    "gps_wrong": Injected(4, WRONG, "PX4 shifts its GPS by a degree and 100 m"),
    "motor_off": Injected(101, OFF, "PX4 stops the motor of this number, 0 lets all run"),
}
OWN: dict[str, Fault] = {
    **{name: fault for name, fault in FAULTS.items() if name != "battery_voltage"},  # PX4 simulates its own battery
    "radio_loss": Fault("", 0, 1, "the radio falls silent"),
    "motor_failed": Fault("", 0, MOTORS, "number of the motor that stops, 0 none"),
}
"""Faults of the world's side."""


class ByParameter(NamedTuple):
    """A fault that the sensors of PX4's own physics have: a parameter, and its size for one of the fault's unit."""

    parameter: str
    share: float = 1.0


OWN_PHYSICS: dict[str, ByParameter] = {
    "gps_satellites": ByParameter("SIM_GPS_USED"),
    "baro_offset": ByParameter("SIM_BARO_OFF_P", -11.4),  # Pa for a metre at 500 m above sea
    **{f"compass_offset_{axis}": ByParameter(f"SIM_MAG_OFFSET_{axis.upper()}") for axis in "xyz"},
}
NOT_OWN_PHYSICS = tuple(name for name in OWN if name not in (*OWN_PHYSICS, "radio_loss"))
"""Faults that only our world makes."""
COMMANDS: dict[str, str] = {
    "MAV_CMD_NAV_TAKEOFF": "climb to a height above home",
    "MAV_CMD_NAV_LAND": "land here",
    "MAV_CMD_NAV_RETURN_TO_LAUNCH": "return and land",
    "MAV_CMD_NAV_LOITER_UNLIM": "hold the place",
    "MAV_CMD_DO_REPOSITION": "fly to a place",
    "MAV_CMD_DO_CHANGE_SPEED": "change the speed of autonomous flight",
    "MAV_CMD_DO_CHANGE_ALTITUDE": "change the height of a hold",
    "MAV_CMD_DO_ORBIT": "fly a circle",
    "MAV_CMD_DO_SET_HOME": "set the home position",
    "MAV_CMD_DO_PAUSE_CONTINUE": "pause or continue a mission",
    "MAV_CMD_DO_SET_MISSION_CURRENT": "go to an item of the mission",
    "MAV_CMD_MISSION_START": "start the mission",
    "MAV_CMD_COMPONENT_ARM_DISARM": "arm or disarm",
    "MAV_CMD_RUN_PREARM_CHECKS": "check whether it may be armed",
    "MAV_CMD_DO_FLIGHTTERMINATION": "stop the motors",
    "MAV_CMD_INJECT_FAILURE": "let a unit fail: unit, type, instance",
    "MAV_CMD_PREFLIGHT_CALIBRATION": "calibrate sensors",
    "MAV_CMD_DO_SET_ACTUATOR": "move a servo output",
    "MAV_CMD_ACTUATOR_TEST": "run one motor",
    "MAV_CMD_DO_MOTOR_TEST": "run one motor",
    "MAV_CMD_DO_SET_ROI_LOCATION": "point at a place",
    "MAV_CMD_DO_SET_ROI_NONE": "point at nothing",
}


class _Check(NamedTuple):
    """An effect that must be seen for an acknowledged order to count: its place in `delivered`, what to look for."""

    place: int
    seen: Callable[[], bool]
    until_s: float
    words: str


class Inputs(inputs.Inputs):
    """Timed inputs, with the faults that the world makes; what PX4 acknowledges must also be seen, where it can be.

    Args:
        vehicle: where effects are seen, and faults of the world's side are put on.
        home_up_m: height of home above sea: PX4 counts the heights of commands from there.
        own_physics: its sensors are those of its own physics, so faults are parameters of these.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        client: Client,
        pulses_us: list[int],
        stimuli: Sequence[Stimulus],
        listing: Listing,
        *,
        home_up_m: float,
        own_physics: bool = False,
    ) -> None:
        super().__init__(client, pulses_us, stimuli, listing, NUMBERS)
        self._vehicle, self._home_up_m, self._own_physics = vehicle, home_up_m, own_physics
        self._checks: list[_Check] = []

    @property
    def finished(self) -> bool:
        """Whether everything was given, every answer came or is overdue, and effects were looked for."""
        return super().finished and not self._checks

    def give_due(self, time_s: float) -> None:
        """Give what is due; note what was never answered, and what was acknowledged without effect."""
        for one in [one for one in self._checks if not one.seen() and one.until_s <= time_s]:
            entry = self.delivered[one.place]
            if entry.answer == "accepted":
                self.delivered[one.place] = msgspec.structs.replace(entry, answer="denied", message=one.words)
        self._checks = [one for one in self._checks if not one.seen() and one.until_s > time_s]
        super().give_due(time_s)

    def _give(self, stimulus: Stimulus, time_s: float) -> DeliveryAnswer:
        if stimulus.kind == "command":
            values = placed(stimulus.name, stimulus.values, self._home_up_m)
            stimulus = msgspec.structs.replace(stimulus, values=values)
        answer = super()._give(stimulus, time_s)
        value = stimulus.values[0] if stimulus.values else 1.0
        look = _look(self._vehicle, stimulus.name, value) if stimulus.kind in ("mode", "sensor_fault") else None
        if look is not None:
            until_s = time_s + EFFECT_S
            self._checks.append(_Check(len(self.delivered), look, until_s, "acknowledged, but without effect"))
        return answer

    def _fault(self, name: str, value: float, time_s: float) -> DeliveryAnswer:
        if name in INJECTED:
            one = INJECTED[name]
            instance = value if name == "motor_off" else ALL
            self._order_command(INJECT_FAILURE, (one.unit, one.type if value else OK, instance), time_s)
            return "timed_out"
        if name == "radio_loss":
            self._vehicle["rc_silent"] = float(value != 0.0)
        elif self._own_physics:
            parameter, share = OWN_PHYSICS[name]
            self._set(parameter, share * value, time_s)
            return "timed_out"
        elif name == "motor_failed":
            self._vehicle.world.fail_motor(round(value))
        else:
            self._vehicle.sensors.set_fault(name, value)
        return "accepted"


def _look(vehicle: Vehicle, name: str, value: float) -> Callable[[], bool] | None:
    """Return what tells that an order acts; None where nothing that PX4 says would."""
    if name in NUMBERS:
        return lambda: vehicle["mode"] == MODES[name]
    if name == "gps_off" and value:
        return lambda: vehicle["gps_ok"] == 0.0
    if name == "motor_off" and value:
        return lambda: vehicle["armed"] == 0.0 or vehicle[f"command_{round(value)}"] == 0.0
    return None


def check_stimulus(stimulus: Stimulus, known: Collection[str], where: str, *, own_physics: bool = False) -> None:
    """Raise Refused for a stimulus that cannot even be given; `known` are the binary's parameters."""
    inputs.check_stimulus(stimulus, known, NUMBERS, where)
    if stimulus.kind == "sensor_fault":
        _check_fault(stimulus.name, stimulus.values[0] if stimulus.values else 1.0, where)
        if own_physics:
            _check_own(stimulus.name, known, where)


def _check_fault(name: str, value: float, where: str) -> None:
    if name in INJECTED:
        top = MOTORS if name == "motor_off" else 1
        if not 0.0 <= value <= top:
            raise Refused(f"sensor fault {name}", where=where, expected=f"0 to {top}", got=value)
        return
    fault = OWN.get(name)
    if fault is None:
        raise Refused("sensor fault", where=where, expected=f"one of {', '.join((*OWN, *INJECTED))}", got=repr(name))
    if not fault.low <= value <= fault.high:
        expected = f"{fault.low:g} to {fault.high:g} {fault.unit}".strip()
        raise Refused(f"sensor fault {name}", where=where, expected=expected, got=value)


def _check_own(name: str, known: Collection[str], where: str) -> None:
    """Raise Refused where no sensor of PX4's own physics has a fault."""
    needed = OWN_PHYSICS[name].parameter if name in OWN_PHYSICS else ""
    if name not in NOT_OWN_PHYSICS and (not needed or needed in known):
        return
    expected = f"physics = jsbsim, or one that the sensors of SIH have: {', '.join(('radio_loss', *OWN_PHYSICS))}"
    got = "physics = sih" if name in NOT_OWN_PHYSICS else f"physics = sih of a build without {needed}"
    raise Refused(f"sensor fault {name}", where=where, expected=expected, got=got)
