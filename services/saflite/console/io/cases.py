"""Test cases from files: competition YAML, our JSON, the recording of a flight, or a mission plan."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from saflite.console.io.arguments import plain_number
from saflite.console.io.target_options import with_settings
from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.test_case import Mission, Scenario, Target, TestCase, Twin

KINDS = ".yaml, .yml (competition), .json (saflite), .mcap (recording), .plan (mission)"


def load_case(path: Path) -> TestCase:
    """Return the test case in a file, and warn of what it says that is not flown.

    A plan of QGroundControl is flown as it stands: no boxes, no inputs, no wind. Raises Refused if the file is missing,
    malformed or of an unknown kind.
    """
    import msgspec

    from saflite.campaign.storage.sqlite import no_run
    from saflite.console.view import out
    from saflite.contract import gaps
    from saflite.contract.outside import parse_json, read_text

    if path.suffix == ".mcap":
        from saflite.recorder.recording import read

        return read(path).test_case
    if path.suffix == ".json":
        text = read_text(path, "test case")
        data = parse_json(text, "test case", str(path))
        try:
            case = wire.convert(data, TestCase)
        except msgspec.MsgspecError as fault:
            raise Refused("test case", where=str(path), expected="a saflite test case", got=str(fault)) from fault
        for words in gaps.unknown(data, TestCase):
            out.warn_once(f"{path}: {words} and not flown")
        if case.scenario.mission is not None:
            warn_of_plan(case.scenario.mission, str(path))
        return case
    if path.suffix in (".yaml", ".yml"):
        from saflite.recorder.exports.aerialist import read_case

        return _holdable(read_case(path, out.warn_once), str(path))
    if path.suffix == ".plan":
        from saflite.flight.mission import load_plan

        mission = load_plan(path)
        warn_of_plan(mission, str(path))
        return _holdable(TestCase(target=Target(), scenario=Scenario(mission=mission)), str(path))
    if not path.exists():
        fix = no_run(path).fix  # most commands that take a test case take a run folder, too
        raise Refused("test case", where=str(path), expected="a readable file", got="none of that name", fix=fix)
    raise Refused("test case", where=str(path), expected=KINDS, got=path.suffix or "no suffix")


def warn_of_plan(mission: Mission, where: str) -> None:
    """Warn of what a mission, read from the file `where`, keeps of its plan that is not flown."""
    from saflite.console.view import out
    from saflite.flight.plan_remarks import plan_remarks

    for remark in plan_remarks(mission, where):
        out.warn_once(remark)


def check_layout(case: TestCase, where: str, anywhere: bool = False) -> None:
    """Raise Refused for boxes that overlap, leave the competition's area or exceed four; `anywhere` lifts the rules.

    What is no box at all (sizes of zero, numbers that are none) and overlap are refused either way.
    """
    from saflite.flight import geometry

    boxes = case.scenario.obstacles
    if anywhere:
        endless = geometry.Area(-math.inf, math.inf, -math.inf, math.inf)
        geometry.check_layout(boxes, endless, max_count=len(boxes), where=where)
    else:
        geometry.check_layout(boxes, where=where)


def with_changes(
    case: TestCase,
    *,
    target: str = "",
    settings: Sequence[str] = (),
    defects: Sequence[str] = (),
    parameters: Iterable[str] = (),
    rng_seed: int | None = None,
    twin: Twin = "",
) -> TestCase:
    """Return the test case with what the command line changes; raises Refused for a parameter without a number."""
    import msgspec

    from saflite.simulator_worker.registry import describe_target

    values = dict(case.target.parameters)
    for text in parameters:
        name, _, number = text.partition("=")
        try:
            values[name] = plain_number(number)
        except argparse.ArgumentTypeError as fault:
            raise Refused("--parameter", expected="NAME=NUMBER", got=repr(text[:80])) from fault
    name = target or case.target.name
    build = case.target.build if name == case.target.name else ""
    changed = msgspec.structs.replace(case.target, name=name, parameters=values, build=build)
    if settings or defects:
        changed = with_settings(changed, describe_target(changed.name), settings, defects)
    seed = case.rng_seed if rng_seed is None else rng_seed
    new = msgspec.structs.replace(case, target=changed, rng_seed=seed, twin=twin or case.twin)
    return _holdable(new, "command line")


def _holdable(case: TestCase, where: str) -> TestCase:
    """Return a test case that every worker can read; raises Refused for a number or word beyond its bounds."""
    import msgspec

    try:
        return wire.convert(msgspec.to_builtins(case), TestCase)
    except msgspec.ValidationError as fault:
        raise Refused("test case", where=where, expected="values that a test case may have", got=str(fault)) from fault
