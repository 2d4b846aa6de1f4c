"""What the parts of the autopilot see of it and of each other, so that no part imports the whole."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol

from saflite.contract.test_case import Mission
from saflite.flight.autopilots.reference.avoidance import Avoidance
from saflite.flight.autopilots.reference.parameters import ParameterSet
from saflite.flight.autopilots.reference.radio import Radio
from saflite.flight.autopilots.reference.vehicle import Vehicle


class FlightMode(Protocol):
    """What failsafes, arming checks and land detection ask of the mode in force."""

    name: ClassVar[str]
    autonomous: ClassVar[bool]
    needs_position: ClassVar[bool]
    manual_throttle: ClassVar[bool]

    def may_arm(self) -> bool:
        """Return whether the vehicle may be armed in this mode."""
        ...

    def may_disarm(self) -> bool:
        """Return whether an idle vehicle on the ground is disarmed after DISARM_DELAY."""
        ...

    def disarms_on_landing(self) -> bool:
        """Return whether standing on the ground ends the flight at once."""
        ...

    def under_way(self) -> bool:
        """Return whether the mode is on its way to a place it was ordered to."""
        ...


class Failsafe(Protocol):
    """What modes and arming checks ask of the failsafes."""

    position: bool
    radio: bool
    battery: bool
    fence: bool

    def limit_altitude(self, altitude_m: float) -> float:
        """Return a target height the fence allows."""
        ...

    def limit_climb(self, climb_mps: float) -> float:
        """Return a climb rate the fence allows."""
        ...

    def limit_speed(self, north_mps: float, east_mps: float) -> tuple[float, float]:
        """Return a speed over ground the fence allows."""
        ...


class Releasable(Protocol):
    """What arming checks ask of the parachute."""

    released: bool


class Landing(Protocol):
    """What modes ask of the land detector."""

    @property
    def touching(self) -> bool:
        """Return whether the ground seems to carry the vehicle."""
        ...


class FlightStack(ABC):
    """State that the parts share, and the orders they may give; `autopilot.py` is its one implementation."""

    board: Vehicle
    defects: frozenset[str]
    parameters: ParameterSet
    radio: Radio
    parachute: Releasable
    landing: Landing
    failsafes: Failsafe
    mode: FlightMode
    time_s: float
    armed: bool
    landed: bool
    taken_off: bool
    mission: Mission | None
    mission_index: int
    home: tuple[float, float, float]
    avoidance: Avoidance | None
    yaw_order_rad: float | None
    speed_order_mps: float | None

    @abstractmethod
    def say(self, text: str, severity: str = "info") -> None:
        """Send a status text."""

    @abstractmethod
    def set_mode(self, name: str, reason: str) -> str:
        """Change the mode; return why not, empty if it did."""

    @abstractmethod
    def disarm(self, reason: str) -> None:
        """Stop the motors."""

    @abstractmethod
    def set_home(self, north_m: float, east_m: float, up_m: float) -> None:
        """Move home; altitudes are measured from it."""

    @abstractmethod
    def lift(self) -> None:
        """Let the motors lift the vehicle: the order to leave the ground."""
