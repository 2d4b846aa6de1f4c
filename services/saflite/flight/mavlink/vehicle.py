"""What a vehicle on a MAVLink link offers: the server side asks nothing else and knows no autopilot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from saflite.contract.flight import TraceMessage
from saflite.contract.test_case import Mission

Triple = tuple[float, float, float]


class Kind(NamedTuple):
    """Who is on the link: MAV_TYPE, MAV_AUTOPILOT and the version, one byte each for major, minor, patch and type."""

    vehicle: int
    autopilot: int
    version: int


class Place(NamedTuple):
    """A place on the globe; the height is above sea."""

    lat_deg: float
    lon_deg: float
    altitude_m: float


class Status(NamedTuple):
    """What the vehicle tells of itself: its own estimate, not the truth.

    Positions and speeds are north, east, down from the origin of the link, angles and rates about the axes forward,
    right, down. `sticks_pwm` is as received, by channel from 1.
    """

    time_s: float
    mode: int
    armed: bool
    landed: bool
    position_m: Triple
    speed_mps: Triple
    attitude_rad: Triple
    rates_rps: Triple
    altitude_m: float  # above home
    home_m: Triple  # north, east, up
    throttle: float  # 0..1
    motors: Sequence[float]  # 0..1
    position_ok: bool
    innovation_ratio: float
    gps_ok: bool
    gps_satellites: int
    gps_position_m: Triple  # north, east, up
    gps_speed_mps: tuple[float, float]
    baro_ok: bool
    radio_ok: bool
    radio_present: bool
    sticks_pwm: Mapping[int, float]
    battery_v: float
    battery_a: float
    battery_left: float  # 1 full, may fall below 0
    fence_on: bool = False
    fence_breached: bool = False


class LinkedVehicle(Protocol):
    """A vehicle as the server side sees it. Reasons returned as text are empty where the order was taken."""

    @property
    def kind(self) -> Kind:
        """Who it is."""
        ...

    @property
    def origin(self) -> Place:
        """Where positions count from."""
        ...

    @property
    def parameters(self) -> Mapping[str, float]:
        """Every parameter and its value."""
        ...

    def parameter_type(self, name: str) -> int:
        """Return the MAV_PARAM_TYPE of a parameter; the value travels as a float whatever it is."""
        ...

    @property
    def texts(self) -> Sequence[TraceMessage]:
        """Everything said since the start; only grows."""
        ...

    @property
    def mission(self) -> Mission | None:
        """The mission on board, without the home item."""
        ...

    @property
    def mission_index(self) -> int:
        """The item being flown or next."""
        ...

    def status(self) -> Status:
        """Return what it tells now."""
        ...

    def say(self, text: str, severity: str = "info") -> None:
        """Send a text in the vehicle's name: info, warning or error."""
        ...

    def set_parameter(self, name: str, value: float) -> str:
        """Set a parameter; return why not."""
        ...

    def execute(self, command: int, numbers: Sequence[float]) -> int:
        """Carry out a MAV_CMD with up to seven numbers; return the MAV_RESULT."""
        ...

    def set_mode(self, number: int) -> str:
        """Change the mode by its custom number; return why not."""
        ...

    def stick(self, channel: int, pwm: float) -> None:
        """Move a stick of the radio."""
        ...

    def go_to(self, north_m: float, east_m: float, altitude_m: float) -> None:
        """Take a place (altitude above home) as set-point, if it listens to any now."""
        ...

    def fly_at(self, north_mps: float, east_mps: float, climb_mps: float) -> None:
        """Take a speed as set-point, if it listens to any now."""
        ...

    def load_mission(self, mission: Mission | None) -> str:
        """Replace the mission on board; return why not."""
        ...

    def jump_to(self, index: int) -> bool:
        """Make an item of the mission current; return whether there is such."""
        ...

    def restart(self) -> bool:
        """Reboot soon; return False where it may not now."""
        ...
