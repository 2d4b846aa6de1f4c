"""Makes what flies a finding without the farm: the maintainers' own binary on its own physics (SIH), by pymavlink."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.standalone import Evidence, Files, as_docstring, filled
from saflite.contract.test_case import Mission, Stimulus, TestCase
from saflite.flight.autopilots.external.aircraft import HOME
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.inputs import command_number
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.flight import DEFAULT_START
from saflite.flight.autopilots.px4.inputs import ALL, INJECT_FAILURE, INJECTED, OK, OWN_PHYSICS
from saflite.flight.autopilots.px4.mission import as_taken
from saflite.flight.autopilots.px4.modes import NUMBERS, arms_in
from saflite.flight.autopilots.px4.places import placed
from saflite.flight.autopilots.px4.settings import as_texts, companion_of, own_physics, start_parameters
from saflite.flight.mavlink.client import CUSTOM_MODE, DO_SET_MODE
from saflite.flight.mavlink.items import item_fields
from saflite.flight.mission import dump_plan

_TEMPLATE = Path(__file__).with_name("script.py")
_OF_OUR_WORLD = ("IMU_INTEG_RATE", "RC_", "RC2_", "COM_RC_IN_MODE")
_BY_MESSAGE = {"COM_RC_IN_MODE": 1.0}  # sticks come as MANUAL_CONTROL
_SILENCE = "radio_loss"
_DESCRIPTION = """Flies a finding on PX4 without the farm that found it: {title}

{asked}
Steps (seconds after the start state: {start}):
{steps}

What it needs: Python 3.10 or later, pymavlink, and PX4 built for its simulator (px4_sitl); found with
  {version}, SHA-256 of program and start-up files {digest}.

  python3 {name} build/px4_sitl_default/bin/px4

What it does: it starts the binary on its own physics (SIH, its quadrotor X; {farm}),
reaches the start state, gives the inputs at their times of simulated time, and tells what happens. Console, track and
ULog stay in a folder. {same}
MAV_CMD_INJECT_FAILURE acts on SIH only where PX4 has it for that unit: the answer is shown. Exit code 0: flown to the
end (or died, where that is the finding); 1: otherwise.

By hand: load the `.params` (and the `.plan`) beside this file with a ground station, then follow the steps."""


def files_of(test_case: TestCase, flight: Flight, evidence: Evidence, binary: Binary, rows: Listing) -> Files:
    """Return what maintainers run and load: script, `.params`, `.plan` where there is a mission, steps.

    Raises:
        Refused: the finding has obstacles, somebody beside PX4 who flies, or faults that SIH's sensors do not have.
    """
    facts = _facts(test_case, flight, evidence, rows)
    stem = evidence.file.removesuffix(".py")
    told = _described(test_case, evidence, binary)
    contents = {"@DESCRIPTION@": as_docstring(told), '{"@FACTS@": 0}': json.dumps(facts, indent=1)}
    files = {
        evidence.file: filled(_TEMPLATE.read_text(encoding="utf-8"), contents),
        f"{stem}.params": _as_params(facts["parameters"], rows.types),
        f"{stem}-steps.txt": told + "\n",
    }
    mission = test_case.scenario.mission
    return files if mission is None else {**files, f"{stem}.plan": dump_plan(mission)}


def _facts(test_case: TestCase, flight: Flight, evidence: Evidence, rows: Listing) -> dict[str, Any]:
    scenario, given = test_case.scenario, test_case.target.parameters
    if scenario.obstacles:
        raise Refused("--standalone", expected="a finding without boxes", got=f"{len(scenario.obstacles)}")
    if companion_of(test_case):
        raise Refused("--standalone", expected="a finding that PX4 flies alone", got=f"a {companion_of(test_case)}")
    mission, start = scenario.mission, scenario.start or DEFAULT_START
    ours = start_parameters(given, rows, obstacles=False)
    kept = {name: value for name, value in ours.items() if name in given or not name.startswith(_OF_OUR_WORLD)}
    mode = "AUTO" if mission is not None else "BRAKE" if start.mode == "GUIDED" else start.mode
    home = HOME if mission is None else (mission.home_lat_deg, mission.home_lon_deg, mission.home_alt_m)
    return {
        "parameters": as_texts({**kept, **_BY_MESSAGE}, rows.types),
        "home": list(home),
        "items": [] if mission is None else [_open(item) for item in _items(mission)],
        "mode": list(NUMBERS[mode]),
        "arms_in": list(NUMBERS[arms_in(mode)]),
        "altitude_m": start.altitude_m,
        "armed": start.armed,
        "inputs": [_input(one, rows.types, home[2]) for one in sorted(test_case.stimuli, key=lambda one: one.at_s)],
        "limit_s": scenario.time_limit_s,
        "died": flight.ending == "autopilot_died",
        "policy": evidence.policy,
        "title": evidence.title,
        "from_s": evidence.from_s,
    }


def _items(mission: Mission) -> list[tuple[float, ...]]:
    return item_fields(as_taken(mission), home=False, not_given=math.nan)


def _open(numbers: tuple[float, ...]) -> list[float | None]:
    """Return numbers as JSON has them: none for those that are left open."""
    return [None if math.isnan(value) else value for value in numbers]


def _input(one: Stimulus, types: Mapping[str, int], home_up_m: float) -> dict[str, Any]:
    """Return what the script gives: a command with its numbers, a parameter with its type, a stick, or silence."""
    row: dict[str, Any] = {"at_s": one.at_s, "kind": one.kind, "name": one.name, "number": 0}
    values: tuple[float, ...] = one.values
    if one.kind == "mode":
        row["number"], values = DO_SET_MODE, (CUSTOM_MODE, *NUMBERS[one.name])
    elif one.kind == "command":
        row["number"], values = command_number(one.name), placed(one.name, one.values, home_up_m)
    elif one.kind == "parameter":
        row["number"] = types[one.name]
    elif one.kind == "sensor_fault":
        value = one.values[0] if one.values else 1.0
        values = (value,)
        if one.name in INJECTED:
            unit, what, _ = INJECTED[one.name]
            row["number"] = INJECT_FAILURE
            values = (unit, what if value else OK, value if one.name == "motor_off" else ALL)
        elif one.name in OWN_PHYSICS and OWN_PHYSICS[one.name].parameter in types:
            parameter, share = OWN_PHYSICS[one.name]
            row.update(kind="parameter", name=parameter, number=types[parameter])
            values = (share * value,)
        elif one.name != _SILENCE:
            raise Refused("--standalone", expected="a finding without faults of our world", got=one.name)
    return {**row, "values": _open(values)}


def _as_params(texts: Mapping[str, str], types: Mapping[str, int]) -> str:
    """Return parameters as QGroundControl loads them: vehicle, component, name, value, MAV_PARAM_TYPE."""
    rows = [f"1\t1\t{name}\t{text}\t{types[name]}" for name, text in texts.items() if name in types]
    return "\n".join(["# Vehicle-Id Component-Id Name Value Type", *rows, ""])


def _described(case: TestCase, evidence: Evidence, binary: Binary) -> str:
    start = case.scenario.start or DEFAULT_START
    own = own_physics(case)
    return _DESCRIPTION.format(
        farm="the farm flew it there, too" if own else "the farm flew an F450 by HIL messages",
        same="The farm has the moments of its inputs in step with the simulation, this script by its clock."
        if own
        else "Vehicle and noise are others than in the farm: what shows again does not hang on them.",
        title=evidence.title,
        asked="".join(f"{what}: {answer}\n" for what, answer in evidence.asked.items()),
        start="the mission's start" if case.scenario.mission else f"{start.mode}, {start.altitude_m:g} m",
        steps="\n".join(f"  {step}" for step in evidence.steps),
        version=binary.version,
        digest=binary.digest,
        name=evidence.file,
    )
