"""One flight with the firmware: powered up, armed, flown to the start state, then given the test case's inputs.

Time runs from the start state. The firmware is a process of its own; when this one was forked, the firmware is forked,
too, before either goes on: so a held flight goes on any number of times.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from saflite.contract.errors import Unavailable
from saflite.contract.flight import Ending, FlightRecord, Trace, TraceMessage
from saflite.contract.memory_faults import is_memory_report
from saflite.contract.service import Cancelled
from saflite.contract.test_case import StartState, TestCase
from saflite.flight.autopilots.betaflight import msp
from saflite.flight.autopilots.betaflight.configuration import EEPROM, Memory, known_settings, tune
from saflite.flight.autopilots.betaflight.firmware import CLOCK_LIBRARY, Variant
from saflite.flight.autopilots.betaflight.inputs import Inputs, spoil_pulses
from saflite.flight.autopilots.betaflight.pilot import Pilot, hands_off
from saflite.flight.autopilots.betaflight.process import Firmware, FirmwareDied, start
from saflite.flight.autopilots.betaflight.signals import SHOWN_SETTINGS, height_tune_usual, trace_names
from saflite.flight.autopilots.betaflight.switches import ON_US, SWITCHES, mode_channels
from saflite.flight.autopilots.betaflight.vehicle import EXITED, GONE, OK, SILENT, TEST, Vehicle
from saflite.flight.autopilots.betaflight.wind import Air
from saflite.flight.world.state import CRASHED, STEP_S

TICK_STEPS = 8
TICK_S = TICK_STEPS * STEP_S
TRACE_STEP_S = 0.02
POWER_UP_S, RADIO_S, ARM_S, CLIMB_S, SETTLE_S = 1.0, 2.5, 10.0, 60.0, 4.0
AFTER_S = 2.0  # recorded after the end
DEFAULT_START = StartState(mode="ANGLE", altitude_m=20.0)
MSP_LINK, UDP_LINK = 1, 2
LINKS = {"msp": MSP_LINK, "udp": UDP_LINK}
SETTING_LINK, SETTING_PILOT = "link", "pilot"
HOLDS, HANDS_OFF = "holds", "hands_off"
_WORDS = {GONE: "the firmware died", SILENT: "the firmware hangs", EXITED: "the firmware ended itself"}
SANITIZER, SIGNAL = "AddressSanitizer", "firmware: signal"
FRAMES_SHOWN = 3
_ADDRESS = re.compile(r"0x[0-9a-f]+")
_FRAME = re.compile(r"#\d+ 0x[0-9a-f]+ in (\w+)")


class BetaflightFlight:
    """A flight; `begin` reaches its start state, `run` flies it all.

    Raises:
        Unavailable: JSBSim or the firmware cannot be brought up.
    """

    def __init__(self, test_case: TestCase, variant: Variant, memory: Memory, folder: Path) -> None:
        self.test_case, self.scenario = test_case, test_case.scenario
        self.start = test_case.scenario.start or DEFAULT_START
        self._variant, self._memory, self._folder = variant, memory, folder
        self.vehicle = Vehicle(test_case.rng_seed)
        self.air = Air(self.vehicle.world, test_case.scenario.wind, test_case.rng_seed)
        self.pilot = Pilot(self.vehicle, self.start.altitude_m)
        self.taken = self.pilot.taken
        self.link = LINKS[str(test_case.target.settings.get(SETTING_LINK, "msp"))]
        self.link_fault = 0
        self._pilot_holds = test_case.target.settings.get(SETTING_PILOT, HOLDS) == HOLDS
        self.inputs = Inputs(self, test_case.stimuli, variant)
        self.ticks = 0
        self.launch = start
        self.start_step = 0  # steps from power-up to the start state
        self._firmware: Firmware | None = None
        self._for_fork: Firmware | None = None  # the firmware's fork for the fork of this process that is being made
        self._owner = 0
        self._trouble = ""
        self.note = ""
        self._ended_s: float | None = None
        self._over_s = -1.0  # the last moment at which nothing but stimuli to come kept the flight from its end

    @property
    def files(self) -> frozenset[int]:
        """What a fork of this process needs open to go on."""
        return frozenset(file for one in (self._firmware, self._for_fork) if one is not None for file in one.files)

    @property
    def time_s(self) -> float:
        """Time since the start state."""
        return self.ticks * TICK_S

    # -- the whole flight -----------------------------------------------------------------------------------------

    def run(self, cancelled: Cancelled) -> FlightRecord:
        """Fly to the end and return the record; raises Unavailable when cancelled."""
        self.begin()
        return self._rest(cancelled)

    @contextmanager
    def forking(self) -> Iterator[None]:
        """Have the firmware forked while this process is: they need not wait for each other."""
        assert self._firmware is not None, "a flight that has not begun is forked"
        with suppress(Unavailable):  # it is gone: the fork finds that out and says so
            self._for_fork = self._firmware.fork()
        yield
        if self._for_fork is not None:
            self._for_fork.leave()
            self._for_fork = None

    def fly_to(self, test_case: TestCase, at_s: float, cancelled: Cancelled) -> bool:
        """Fly a test case with the same past until just before what is due at `at_s`; False if it ends before.

        Raises:
            Unavailable: it was cancelled.
        """
        self._follow(test_case)
        while round(self.time_s, 6) < at_s - 1e-9:
            ending = self._step(cancelled)
            if ending not in (None, "completed") or self.time_s >= self.scenario.time_limit_s - 1e-9:
                return False
        return True

    def fly_on(self, test_case: TestCase, cancelled: Cancelled) -> FlightRecord | None:
        """Fly a test case with the same past to its end; None if that flight had ended before this moment.

        Raises:
            Unavailable: it was cancelled.
        """
        self._follow(test_case)
        if self.inputs.finished and self._over_s >= self.inputs.last_s:
            return None
        self._ended_s = None
        return self._rest(cancelled)

    def close(self) -> None:
        """End the firmware."""
        if self._firmware is not None:
            self._firmware.close()

    def take_up(self) -> None:
        """In a fork of the process that held it: go on with a fork of the firmware.

        Raises:
            Unavailable: the held firmware is gone.
        """
        self._follow(self.test_case)

    def _follow(self, test_case: TestCase) -> None:
        self.inputs.replace(test_case.stimuli)
        self.test_case = test_case
        if self._owner != os.getpid():
            self._fork_firmware()

    def _fork_firmware(self) -> None:
        assert self._firmware is not None, "a flight that has not begun was forked"
        held, self._firmware, self._for_fork = self._firmware, self._for_fork or self._firmware.fork(), None
        held.leave()
        self._owner = os.getpid()
        came = self.vehicle.connect(self._firmware.fd)
        if came != OK:
            raise Unavailable(f"{_WORDS[came]} when it was forked: {self._firmware.last_words()[-300:]!r}")
        self._firmware.watch(self.vehicle.pid)

    def _rest(self, cancelled: Cancelled) -> FlightRecord:
        try:
            ending: Ending | None = None
            while ending is None:
                ending = self._step(cancelled)
            return self._record(ending)
        finally:
            self.close()

    def _record(self, ending: Ending) -> FlightRecord:
        assert self._firmware is not None, "a flight that has not begun was recorded"
        message = ""
        artefacts: tuple[tuple[str, bytes], ...] = ()
        said: tuple[TraceMessage, ...] = ()
        if self.note:
            message = f"start state not reached: {self.note}"
            said = (TraceMessage(at_s=0.0, text=message, severity="warning"),)
        if ending == "autopilot_died":
            console = self._firmware.last_words()
            message = f"{self._trouble}: {_reason(console)}"
            said = (*said, TraceMessage(at_s=self.time_s, text=message, severity="error"))
            artefacts = (("console.txt", console.encode()),)
        trace = Trace(step_s=TRACE_STEP_S, signals=self.vehicle.columns(), messages=said)
        return FlightRecord(ending, trace, message, tuple(self.inputs.delivered), artefacts)

    def _step(self, cancelled: Cancelled) -> Ending | None:
        if self.ticks % 50 == 0 and cancelled():
            raise Unavailable("flight cancelled")
        self.inputs.tick(round(self.time_s, 6))
        came = self._tick()
        self.ticks += 1
        if came == EXITED and self.vehicle.exit_code == 0 and self.vehicle["armed"] == 0.0:
            return "completed"  # restarted on the ground, as it was told
        if came != OK:
            self._trouble = _WORDS[came]
            return "autopilot_died"
        return self._ending()

    def _tick(self) -> int:
        """Pilot and air, then 20 ms of firmware and world."""
        if self._pilot_holds and self.vehicle["armed"] != 0.0:
            self.pilot.move()
        spoil_pulses(self)
        self.air.tick()
        return self.vehicle.run(TICK_STEPS)

    def _ending(self) -> Ending | None:
        time_s, board = self.time_s, self.vehicle
        if board["world_state"] == CRASHED:
            return "crashed"
        over = self.start.armed and board["landed"] != 0.0 and board["armed"] == 0.0
        if over:
            self._over_s = time_s
        if not over or not self.inputs.finished:
            self._ended_s = None
        elif self._ended_s is None:
            self._ended_s = time_s
        if self._ended_s is not None and time_s - self._ended_s >= AFTER_S:
            return "completed"
        return "completed" if time_s >= self.scenario.time_limit_s - 1e-9 else None

    # -- start ----------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Power up, arm, reach the start state and start the trace.

        Where the vehicle does not get there as it is set up, the flight starts from where it is; `note` says so.

        Raises:
            FirmwareDied: it ends before.
            Unavailable: it cannot be started.
        """
        (self._folder / EEPROM).write_bytes(self._memory.eeprom)
        self._firmware = self.launch(self._variant.binary, CLOCK_LIBRARY, self._folder)
        self._owner = os.getpid()
        try:
            self._power_up()
            if self.start.armed:
                self.note = self._arm() or (self._climb() if self.start.altitude_m > 0.0 else "")
        except (FirmwareDied, Unavailable):
            self.close()
            raise
        self.ticks = 0
        self.start_step = int(self.vehicle["step"])
        self.vehicle.record(trace_names(), int(self.scenario.time_limit_s / TRACE_STEP_S) + 2, TRACE_STEP_S)

    def _power_up(self) -> None:
        board, known = self.vehicle, known_settings(self._variant)
        set_up = {**tune(self._variant), **self.test_case.target.parameters}
        for slot, (name, scale) in SHOWN_SETTINGS.items():
            board[slot] = scale * set_up.get(name, known[name].default if name in known else 0.0)
        board["settings_lost"] = float(len(self._memory.lost))
        board["height_tune_usual"] = float(height_tune_usual(set_up))
        hands_off(board)
        self._check(board.connect(self._files_fd()))
        self._wait(POWER_UP_S)
        board.listen(TEST)
        board.say(TEST, msp.frame(msp.BOX_IDS))
        self._wait(0.2)
        boxes = next((one.payload for one in msp.answers(board.heard(TEST)) if one.command == msp.BOX_IDS), b"")
        if not boxes:
            raise FirmwareDied("the firmware does not say which boxes it has")
        board.know_boxes(boxes)
        board["rc_link"] = float(self.link)
        self._wait(RADIO_S)

    def _files_fd(self) -> int:
        assert self._firmware is not None, "no firmware to connect to"
        return self._firmware.fd

    def _arm(self) -> str:
        """Arm; return why not, empty if it did."""
        board, waited_s = self.vehicle, 0.0
        while board["arming_forbidden"] != 0.0 and waited_s < ARM_S:
            self._wait(TICK_S)
            waited_s += TICK_S
        for channel, pulse_us in mode_channels("ANGLE").items():
            board[f"rc_{channel}"] = pulse_us
        board[f"rc_{SWITCHES['ARM'].channel}"] = ON_US
        self._wait(0.5)
        return "" if board["armed"] != 0.0 else f"did not arm, arming flags {int(board['arming_flags']):#x}"

    def _climb(self) -> str:
        """Take off and hover in the mode of the start state; return why not, empty if it does."""
        board, waited_s, near_s = self.vehicle, 0.0, 0.0
        while near_s < SETTLE_S:
            self.pilot.move()
            self._wait(TICK_S)
            waited_s += TICK_S
            near = abs(board["altitude_m"] - self.start.altitude_m) < 0.5 and board["home_distance_m"] < 1.5
            near_s = near_s + TICK_S if near else 0.0
            if board["world_state"] == CRASHED or board["armed"] == 0.0 or waited_s > CLIMB_S:
                return f"at {board['altitude_m']:.1f} m after {waited_s:.0f} s, armed {board['armed']:.0f}"
        for channel, pulse_us in mode_channels(self.start.mode).items():
            board[f"rc_{channel}"] = pulse_us
        for _ in range(round(SETTLE_S / TICK_S / 2)):
            self._check(self._tick())
        return ""

    def _wait(self, duration_s: float) -> None:
        for _ in range(round(duration_s / TICK_S)):
            self.air.tick()
            self._check(self.vehicle.run(TICK_STEPS))

    def _check(self, came: int) -> None:
        if came != OK:
            assert self._firmware is not None, "no firmware was started"
            raise FirmwareDied(f"{_WORDS[came]} before the start: {_reason(self._firmware.last_words())}")


def _reason(console: str) -> str:
    """Return the line of what the firmware printed that says why it ended."""
    lines = [line.strip() for line in console.splitlines() if line.strip()]
    report = next((place for place, line in enumerate(lines) if SANITIZER in line and "ERROR" in line), -1)
    if report >= 0:
        return _sanitizer_words(lines[report:])
    told = next((line for line in reversed(lines) if SIGNAL in line), "")
    told = told or next(filter(is_memory_report, lines), lines[-1] if lines else "it said nothing")
    return _ADDRESS.sub("0x..", told)


def _sanitizer_words(lines: list[str]) -> str:
    """Return what a sanitizer reports and where: no addresses, so that equal reports read the same."""
    kind = lines[0].partition(f"{SANITIZER}: ")[2].split(" ")[0]
    frames = [found[1] for found in map(_FRAME.match, lines) if found]
    return f"{SANITIZER}: {kind} in {' < '.join(frames[:FRAMES_SHOWN])}"
