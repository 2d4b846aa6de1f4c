"""One flight in Aerialist's container: a test file and a plan go in, PX4's log comes out and becomes the trace.

Its command line after docs/CLI.md and its Docker agent (Aerialist of December 2025): `python3 aerialist exec --test
FILE` in the image's working folder, real time, the log's place after `LOG:` or `logging started:` in what it prints.
What it cannot say is not guessed: without a log the flight is trouble of the infrastructure, never a finding.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from saflite.contract.clock import Clock
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import Ending, FlightRecord, Trace
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.aerialist.container import OUTPUT_BYTES_MAX, Image
from saflite.flight.competition import yaml_text
from saflite.flight.competition.document import to_document
from saflite.flight.geometry import CORE_SCALE, boxes_array, distance_to_boxes
from saflite.flight.logs.files import read_log
from saflite.flight.mission import dump_plan

SIGNALS = (
    *("x_m", "y_m", "altitude_m", "vx_mps", "vy_mps", "climb_mps"),
    *("roll_deg", "pitch_deg", "yaw_deg", "mode", "armed", "contact"),
)
FOLDER = "/src/aerialist/results/"  # of the image, where its own Docker agent puts tests
CASE, PLAN = "case.yaml", "mission.plan"
BOXES_MAX = 4
LOG_BYTES_MAX = 64 * 2**20
_PLACES = ("LOG:", "logging started:")


def test_file(test_case: TestCase) -> str:
    """Return the test as Aerialist reads it, its mission beside it in the container."""
    document: dict[str, Any] = to_document(test_case, PLAN)
    robot = next(document[word] for word in ("robot", "drone") if word in document)
    robot["mission_file"] = FOLDER + PLAN
    document["simulation"]["timeout"] = round(test_case.scenario.time_limit_s)
    document["agent"] = {"engine": "local", "count": 1}
    return yaml_text.write(document)


def fly(
    image: Image, container: str, folder: Path, test_case: TestCase, clock: Clock, late_s: float, cancelled: Cancelled
) -> FlightRecord:
    """Fly once in a container of that name; `folder` is empty and private.

    Raises Unavailable where the engine or the simulation does not come up, no log comes out, or it was cancelled.
    """
    mission = test_case.scenario.mission
    assert mission is not None, "checked before"
    (folder / CASE).write_text(test_file(test_case), encoding="utf-8")
    (folder / PLAN).write_text(dump_plan(mission), encoding="utf-8")
    console, log = folder / "console.txt", folder / "flight.ulg"
    image.run(container, max(1.0, late_s - clock.monotonic_s()))
    try:
        for name in (CASE, PLAN):
            image.copy_in(folder / name, container, FOLDER)
        command = ["python3", "aerialist", "exec", "--test", FOLDER + CASE]
        code = image.execute(container, command, console, clock, late_s, cancelled)
        said = _tail(console)
        if code is None:
            return FlightRecord("wedged", None, "no end within its deadline", artefacts=(("console.txt", said),))
        image.copy_out(container, log_place(said.decode(errors="replace"), code), log)
    finally:
        image.remove(container)
    return _record(test_case, log, said)


def _tail(console: Path) -> bytes:
    """Return the end of what was printed: all of it may be more than memory holds."""
    with console.open("rb") as file:
        file.seek(max(0, file.seek(0, os.SEEK_END) - OUTPUT_BYTES_MAX))
        return file.read(OUTPUT_BYTES_MAX)


def log_place(said: str, code: int) -> str:
    """Return where in the container the log lies, from what Aerialist printed; raises Unavailable without it."""
    for words in _PLACES:
        after = said.rpartition(words)[2].split() if words in said else []
        if after:
            return after[0]
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    last = lines[-1][:300] if lines else "nothing printed"
    raise Unavailable(f"aerialist ended with code {code} and named no log: {last}")


def _record(test_case: TestCase, log: Path, said: bytes) -> FlightRecord:
    if log.is_symlink():  # the engine copies links as such: this one leads to a file of ours, not of the container
        raise Unavailable("the log of the flight is a link in the container")
    size_bytes = log.stat().st_size if log.is_file() else 0
    try:
        read = read_log(log, placed=True)
        trace = trace_of(test_case, read.trace)
    except Refused as fault:
        raise Unavailable(f"the log of the flight ({size_bytes} bytes): {fault}") from fault
    artefacts: tuple[tuple[str, bytes], ...] = (("console.txt", said),)
    if size_bytes <= LOG_BYTES_MAX:
        artefacts = (*artefacts, ("flight.ulg", log.read_bytes()))
    return FlightRecord(_ending(trace, read.crashed), trace, artefacts=artefacts)


def trace_of(test_case: TestCase, logged: Trace) -> Trace:
    """Return the signals of `SIGNALS`: those logged, and `contact` from the track and the boxes' solid cores.

    Raises Refused where the log lacks one of them.
    """
    boxes = tuple(
        msgspec.structs.replace(box, length_m=CORE_SCALE * box.length_m, width_m=CORE_SCALE * box.width_m)
        for box in test_case.scenario.obstacles
    )
    points = np.column_stack([logged.array(name) for name in ("x_m", "y_m", "altitude_m")]).astype(np.float64)
    touching = distance_to_boxes(points, boxes_array(boxes)) <= 0.0
    signals = {name: logged.array(name).tobytes() for name in SIGNALS if name != "contact"}
    return msgspec.structs.replace(logged, signals={**signals, "contact": touching.astype("<f4").tobytes()})


def _ending(trace: Trace, crashed: bool) -> Ending:
    """A flight that was armed and has been disarmed again is over; another one ran out of its time."""
    if crashed:
        return "crashed"
    armed = trace.array("armed") > 0.0
    return "completed" if armed.any() and not armed[-1] else "timed_out"
