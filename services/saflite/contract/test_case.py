"""What is flown: a target, a scenario (mission, obstacles, wind), timed stimuli and a random seed.

Frame of the testing competition throughout: x north, y east, z up, metres from the take-off point; rotation in
degrees, counter-clockwise in the (x, y) plane about the centre of the box.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from saflite.contract.bounds import (
    Count,
    Document,
    Latitude,
    Longitude,
    Number,
    Place,
    RngSeed,
    Seconds,
    Single,
    Text,
    Whole,
    Word,
)
from saflite.contract.ids import short_id
from saflite.contract.rng import derive_seed

DEFAULT_TARGET = "reference"  # the target that is always there
StimulusKind = Literal["parameter", "command", "stick", "mode", "sensor_fault"]
Twin = Literal["", "turned", "idle", "afresh", "mirrored", "recalibrated"]
"""A second flight that must go as the first, and what is changed in it (metamorphic testing, Chen et al. 1998).

turned  everything is turned about the take-off point by a right angle: the start, places, headings, wind, boxes
idle    what the autopilot refused, or what acts at the next start only, is not given at all
afresh  only settings are given until the vehicle is ordered for the last time to a place where nothing follows for 12 s
mirrored      left and right are exchanged: the start, places, headings, sticks, turns, wind, boxes
recalibrated  the pilot's radio sends other pulses, of half the span, and the autopilot is calibrated for them
"""

Plain = Number | Whole | Text | bool
Setting = Plain | Annotated[list[Plain], msgspec.Meta(max_length=10_000)]
VALUES_MAX = 4096
"""Of one input: raw bytes sent to an autopilot are the longest."""

Parameters = Annotated[dict[Word, Single], msgspec.Meta(max_length=10_000)]
Settings = Annotated[dict[Word, Setting], msgspec.Meta(max_length=1_000)]
STIMULI_MAX = OBSTACLES_MAX = ITEMS_MAX = 10_000


class Obstacle(msgspec.Struct, frozen=True, kw_only=True):
    """A box standing on z. `length_m` lies along x before rotation, `width_m` along y."""

    length_m: Single
    width_m: Single
    height_m: Single
    x_m: Single
    y_m: Single
    z_m: Single = 0.0
    rotation_deg: Single = 0.0


class MissionItem(msgspec.Struct, frozen=True, kw_only=True):
    """One MAVLink mission item as QGroundControl stores it (`params` 1..7, None where the file holds null)."""

    command: Whole
    frame: Whole = 3
    params: Annotated[tuple[Single | None, ...], msgspec.Meta(min_length=7, max_length=7)] = (
        *(0.0, 0.0, 0.0),
        *(None, None, None, None),
    )
    auto_continue: bool = True
    jump_id: Whole = 0
    extra: Annotated[dict[Word, Plain | None], msgspec.Meta(max_length=100)] = {}


class Mission(msgspec.Struct, frozen=True, kw_only=True):
    """A mission in geographic coordinates, as in a QGroundControl `.plan`.

    `plan_extra` keeps, as canonical JSON text, what the file holds besides (fence, rally points, versions), so that
    writing it again loses nothing.
    """

    name: Text
    home_lat_deg: Latitude
    home_lon_deg: Longitude
    home_alt_m: Single
    items: Annotated[tuple[MissionItem, ...], msgspec.Meta(max_length=ITEMS_MAX)]
    plan_extra: Document = "{}"


class Wind(msgspec.Struct, frozen=True, kw_only=True):
    """Steady wind plus gusts. `from_deg` is the compass direction it blows from."""

    mean_mps: Single = 0.0
    from_deg: Single = 0.0
    gust_mps: Single = 0.0
    gust_period_s: Single = 10.0


class StartState(msgspec.Struct, frozen=True, kw_only=True):
    """Where a flight without a mission begins: armed and hovering in `mode` at `altitude_m`, or on the ground."""

    mode: Word = "GUIDED"
    altitude_m: Single = 20.0
    armed: bool = True


class Scenario(msgspec.Struct, frozen=True, kw_only=True):
    """The world of a flight. With a mission it is flown from the ground; without one `start` holds."""

    mission: Mission | None = None
    start: StartState | None = None
    obstacles: Annotated[tuple[Obstacle, ...], msgspec.Meta(max_length=OBSTACLES_MAX)] = ()
    wind: Wind = Wind()
    time_limit_s: Seconds = 500.0


class Stimulus(msgspec.Struct, frozen=True, kw_only=True):
    """One input given at `at_s` after the start state is reached.

    `name` is a parameter name, a MAV_CMD name, `RC1`..`RC8`, a mode name, or a sensor fault name;
    `values` holds the parameter value, the command's up to seven numbers, the stick's PWM, the fault's size, or the
    bytes of a raw message.
    """

    at_s: Single
    kind: StimulusKind
    name: Word
    values: Annotated[tuple[Single, ...], msgspec.Meta(max_length=VALUES_MAX)] = ()


class Target(msgspec.Struct, frozen=True, kw_only=True):
    """Vehicle and autopilot, the parameters set before take-off, the target's own settings.

    `settings` are listed by `TargetInfo.settings`. `build` is the digest of the code and binaries that are to fly
    (`TargetInfo.build`); empty means any.
    """

    name: Word = DEFAULT_TARGET
    parameters: Parameters = {}
    settings: Settings = {}
    build: Word = ""


class Origin(msgspec.Struct, frozen=True, kw_only=True):
    """Where a test case came from; `arm` names the arm of a portfolio. Not part of its identity."""

    strategy: Word = ""
    arm: Word = ""
    parent: Word = ""
    round: Place = 0
    index: Count = 0
    note: Text = ""


class TestCase(msgspec.Struct, frozen=True, kw_only=True):
    """What is flown. Two test cases with equal content are the same test case (`identity`).

    `heading_deg` turns the heading with which the target begins, clockwise. With a `twin` a second flight is flown, and
    the trace of the first holds how far they are apart (`contract/signals.py`, `twin_*`).
    `source` keeps, as canonical JSON text, the competition YAML a test case was read from, so that writing it again
    loses nothing; like `origin` it is not part of the identity.
    """

    __test__ = False  # tells pytest that this is not a test class

    target: Target
    scenario: Scenario
    stimuli: Annotated[tuple[Stimulus, ...], msgspec.Meta(max_length=STIMULI_MAX)] = ()
    rng_seed: RngSeed = 0
    heading_deg: Single = 0.0
    twin: Twin = ""
    origin: Origin = Origin()
    source: Document = ""


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")


def identity(test_case: TestCase) -> str:
    """Return the identity of a test case: the hash of all it holds except its origin and source."""
    content = (test_case.target, test_case.scenario, test_case.stimuli, test_case.rng_seed)
    more = (test_case.heading_deg, test_case.twin)
    return short_id(_ENCODER.encode((*content, *more) if any(more) else content))


def draw_key(test_case: TestCase) -> str:
    """Return what random draws and the breaking of ties go by: the identity the test case has on no certain build.

    So two builds of a target are searched with the same draws, and can be compared.
    """
    return identity(msgspec.structs.replace(test_case, target=msgspec.structs.replace(test_case.target, build="")))


def under_noise(test_case: TestCase, number: int) -> TestCase:
    """Return the test case with the `number`-th random seed for what is noise in a flight; 0 is the test case's own."""
    if not number:
        return test_case
    return msgspec.structs.replace(test_case, rng_seed=derive_seed(test_case.rng_seed, "noise", number))


def cut_off(test_case: TestCase, until_s: float | None) -> TestCase:
    """Return the test case with simulated time running out at `until_s` at the latest; None: when it does anyway."""
    if until_s is None or until_s >= test_case.scenario.time_limit_s:
        return test_case
    scenario = msgspec.structs.replace(test_case.scenario, time_limit_s=until_s)
    return msgspec.structs.replace(test_case, scenario=scenario)


def stimulus_text(stimulus: Stimulus) -> str:
    """Return a stimulus in words: what it is, its numbers."""
    numbers = "".join(f" {value:g}" for value in stimulus.values)
    return f"{stimulus.kind} {stimulus.name}{numbers}"


TWIN_WORDS: dict[Twin, str] = {
    "turned": "turned by a right angle",
    "idle": "without what was refused or waits for a restart",
    "afresh": "without what came before",
    "mirrored": "with left and right exchanged",
    "recalibrated": "by a radio of another calibration",
}


def twin_text(twin: Twin) -> str:
    """Return in words which flights are compared, empty for one flight alone."""
    return f"flown twice: as it is, and {TWIN_WORDS[twin]}" if twin else ""


def told_in_order(stimuli: tuple[Stimulus, ...]) -> str:
    """Return stimuli in words, each with its time."""
    return "; ".join(f"{stimulus.at_s:g} s {stimulus_text(stimulus)}" for stimulus in stimuli)


def setting_text(value: Setting) -> str:
    """Return a setting in words: a list with commas."""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
