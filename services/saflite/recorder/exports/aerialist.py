"""Test cases as the UAV testing competition's YAML (Aerialist), each mission's `.plan` beside it.

One file per violation, named by its test case. Both spellings are read (robot/mission and drone/test); writing what
was read loses nothing. Also called `yaml`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import msgspec

from saflite.contract.errors import Refused
from saflite.contract.outside import read_text
from saflite.contract.test_case import Mission, TestCase, identity
from saflite.flight.competition import document as competition
from saflite.flight.competition import yaml_text
from saflite.flight.competition.remarks import remarks
from saflite.flight.mission import load_plan
from saflite.flight.plan_remarks import plan_remarks
from saflite.recorder.files import write_file
from saflite.recorder.plans import with_readable_rest, write_plan
from saflite.recorder.summary import RunSummary

ALIASES = ("yaml",)

Tell = Callable[[str], None]
"""Takes a line for the user on what a file says that is not flown."""


def _untold(_: str) -> None:
    """Tell nobody."""


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write one YAML per violation and the missions they name into `folder`; returns the files written."""
    written: list[Path] = []
    for finding in summary.findings:
        written.extend(write_case(_readable(finding.test_case), folder, identity(finding.test_case)))
    return tuple(dict.fromkeys(written))


def _readable(test_case: TestCase) -> TestCase:
    """Return a test case without what it says it was read from, where no file can be made of that."""
    scenario = test_case.scenario
    if scenario.mission is not None:
        scenario = msgspec.structs.replace(scenario, mission=with_readable_rest(scenario.mission))
        test_case = msgspec.structs.replace(test_case, scenario=scenario)
    try:
        competition.to_document(test_case)
    except Refused:
        return msgspec.structs.replace(test_case, source="")
    return test_case


def write_case(test_case: TestCase, folder: Path, stem: str = "") -> tuple[Path, ...]:
    """Write the test case as `folder/stem.yaml` (its identity if no stem is given) with its mission beside it."""
    path = folder / f"{stem or identity(test_case)}.yaml"
    document = competition.to_document(test_case)
    mission, written = test_case.scenario.mission, [path]
    if mission is not None:
        robot = next(document[word] for word in competition.ROBOT_WORDS if word in document)
        plan = write_plan(mission, folder, robot["mission_file"])
        document = competition.to_document(test_case, plan.name)
        written.append(plan)
    write_file(path, yaml_text.write(document))
    return tuple(written)


def read_case(path: Path, tell: Tell = _untold) -> TestCase:
    """Return the test case in a competition YAML, and tell what it and its mission file say that is not flown.

    Its mission file is looked for as named from the YAML's folder, then from the working directory, then by its bare
    name beside the YAML. Raises Refused with file and line for what cannot be understood or flown.
    """
    return parse_case(read_text(path, "test case"), str(path), path.parent, tell)


def parse_case(text: str, where: str, folder: Path, tell: Tell = _untold) -> TestCase:
    """Return the test case in the text of a competition YAML; `folder` is where its mission file is looked for."""

    def find(plan: str, place: str) -> Mission:
        for candidate in (folder / plan, Path(plan), folder / Path(plan).name):
            if os.path.isfile(candidate):  # unlike Path.is_file: of any name
                mission = load_plan(candidate)
                for remark in plan_remarks(mission, str(candidate)):
                    tell(remark)
                return mission
        fix = f"put {Path(plan).name} beside the YAML"
        raise Refused("mission_file", where=place, expected="a .plan file that is there", got=repr(plan), fix=fix)

    document = yaml_text.read(text, where)
    case = competition.to_test_case(document, find)
    for remark in remarks(document, case):
        tell(remark)
    return case
