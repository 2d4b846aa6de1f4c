"""Makes what flies a finding without the farm: the maintainers' own binary on its own physics, in their own tools."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.standalone import Evidence, Files, as_docstring, filled
from saflite.contract.test_case import Stimulus, TestCase
from saflite.flight.autopilots.ardupilot.mission import as_taken
from saflite.flight.autopilots.ardupilot.settings import F450, as_file, start_parameters
from saflite.flight.autopilots.ardupilot.telemetry import MODES
from saflite.flight.autopilots.external.aircraft import HOME
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.flight import DEFAULT_START
from saflite.flight.autopilots.external.inputs import command_number
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.mavlink.client import CUSTOM_MODE, DO_SET_MODE
from saflite.flight.mavlink.items import ORDERED_PLACES, command_int_fields, item_fields
from saflite.flight.mission import MISSION_YAW_DEG, dump_plan

_TEMPLATE, _CASE = (Path(__file__).with_name(name) for name in ("script.py", "autotest_case.py"))
_NOT_THEIRS = frozenset({*F450, "SERIAL1_PROTOCOL", "SERIAL2_PROTOCOL"})
_HEADER = """Flies a finding on ArduCopter without the farm that found it: {title}

{asked}
Steps (seconds after the start state: {start}):
{steps}

What it needs: Python 3.9 or later, pymavlink, and ArduCopter built for SITL; found with
  {version}, SHA-256 {digest}.

{run}"""
_RUN_SCRIPT = """  python3 {name} build/sitl/bin/arducopter

What it does: it starts the binary on its own physics (a quadrotor X, stock gains; the farm flew an F450 with gains of
its own), reaches the start state, gives the inputs at their times of simulated time, and tells what happens. Parameters
(`start.parm`), track and DataFlash log stay in a folder. Vehicle and noise are others than in the farm: what shows
again does not hang on them. Exit code 0: flown to the end (or died, where that is the finding); 1: otherwise.

By hand: load the `.parm` (and the `.plan`) beside this file with a ground station, then follow the steps."""
_RUN_CASE = """  PYTHONPATH=path/to/ardupilot/Tools/autotest python3 {name} build/sitl/bin/arducopter

What it does: a case of ArduPilot's own autotest, in its suite for Copter and run by it, which also needs pexpect and
MAVProxy. It fails where the autopilot dies, or where `saflite judge` is at hand and finds the rule broken."""


def files_of(test_case: TestCase, flight: Flight, evidence: Evidence, binary: Binary, rows: Listing) -> Files:
    """Return what maintainers run and load: script, autotest case, `.parm`, `.plan` where there is a mission, steps.

    Raises:
        Refused: the finding has obstacles, which the autopilot's own physics does not know.
    """
    facts = _facts(test_case, flight, evidence, rows)
    stem = evidence.file.removesuffix(".py")
    told = _described(_RUN_SCRIPT, test_case, evidence, binary)
    files = {
        evidence.file: _filled(_TEMPLATE, told, facts),
        f"{stem}-autotest.py": _filled(_CASE, _described(_RUN_CASE, test_case, evidence, binary), facts),
        f"{stem}.parm": as_file(facts["parameters"]),
        f"{stem}-steps.txt": told + "\n",
    }
    mission = test_case.scenario.mission
    return files if mission is None else {**files, f"{stem}.plan": dump_plan(as_taken(mission))}


def _facts(test_case: TestCase, flight: Flight, evidence: Evidence, rows: Listing) -> dict[str, Any]:
    scenario, given = test_case.scenario, test_case.target.parameters
    if scenario.obstacles:
        raise Refused("--standalone", expected="a finding without boxes", got=f"{len(scenario.obstacles)}")
    mission, start = scenario.mission, scenario.start or DEFAULT_START
    ours = start_parameters(given, rows.parameters, obstacles=False)
    wind = {"SIM_WIND_SPD": scenario.wind.mean_mps, "SIM_WIND_DIR": scenario.wind.from_deg}
    parameters = {name: value for name, value in ours.items() if name in given or name not in _NOT_THEIRS}
    home = HOME if mission is None else (mission.home_lat_deg, mission.home_lon_deg, mission.home_alt_m)
    return {
        "parameters": {**(wind if scenario.wind.mean_mps else {}), **parameters},
        "home": [*home, (test_case.heading_deg + (0.0 if mission is None else MISSION_YAW_DEG)) % 360.0],
        "items": [] if mission is None else item_fields(as_taken(mission), home=True, not_given=0.0),
        "mode": MODES[start.mode],
        "mode_name": start.mode,
        "altitude_m": start.altitude_m,
        "armed": start.armed,
        "inputs": [_input(one, rows.types) for one in sorted(test_case.stimuli, key=lambda one: one.at_s)],
        "limit_s": scenario.time_limit_s,
        "died": flight.ending == "autopilot_died",
        "policy": evidence.policy,
        "title": evidence.title,
        "from_s": evidence.from_s,
    }


def _filled(template: Path, description: str, facts: Mapping[str, Any]) -> str:
    text = template.read_text(encoding="utf-8")
    return filled(text, {"@DESCRIPTION@": as_docstring(description), '{"@FACTS@": 0}': json.dumps(facts, indent=1)})


def _input(one: Stimulus, types: Mapping[str, int]) -> dict[str, Any]:
    """Return what the script gives: a command with its numbers, a parameter with its type, or a stick."""
    row: dict[str, Any] = {
        "at_s": one.at_s,
        "kind": one.kind,
        "name": one.name,
        "values": list(one.values),
        "number": 0,
    }
    if one.kind == "mode":
        row.update(number=DO_SET_MODE, values=[CUSTOM_MODE, MODES[one.name]])
    elif one.kind == "command":
        row["number"] = command_number(one.name)
        if row["number"] in ORDERED_PLACES:  # a place goes with the frame of its height, as the farm gives it
            row["placed"] = command_int_fields(row["number"], one.values)
    elif one.kind != "stick":
        row["number"] = types[one.name]
    return row


def _described(run: str, case: TestCase, evidence: Evidence, binary: Binary) -> str:
    start = case.scenario.start or DEFAULT_START
    file = evidence.file if run == _RUN_SCRIPT else evidence.file.replace(".py", "-autotest.py")
    return _HEADER.format(
        title=evidence.title,
        asked="".join(f"{what}: {answer}\n" for what, answer in evidence.asked.items()),
        start="the mission's start" if case.scenario.mission else f"{start.mode}, {start.altitude_m:g} m",
        steps="\n".join(f"  {step}" for step in evidence.steps),
        version=binary.version,
        digest=binary.digest,
        run=run.format(name=file),
    )
