"""Is what a strategy proposes fit to be flown? The same question wherever it is asked, in a farm or by hand."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.test_case import TestCase
from saflite.flight.competition.document import to_document
from saflite.flight.mission import dump_plan

TEST_CASE_BYTES_MAX = 2**18
BATCH_BYTES_MAX = 8 * 2**20  # of test cases that are scored at a time; outcomes are told beside them


class Unfit(NamedTuple):
    """What was expected of the test cases, and what they are instead."""

    expected: str
    got: object


def unfit(cases: Sequence[TestCase], template: TestCase, most: int, batch: int) -> Unfit | None:
    """Return why test cases cannot be taken as a round, None if they can.

    Args:
        cases: what was proposed.
        template: what the campaign's test cases start from.
        most: how many there may be.
        batch: how many are scored at a time.
    """
    if len(cases) > most:
        return Unfit(f"at most {most} test cases", len(cases))
    found = next((why for case in cases for why in _unfit(case, template)), None)
    largest = sum(sorted((len(wire.encode(case)) for case in cases), reverse=True)[:batch])
    if found is None and largest > BATCH_BYTES_MAX:
        return Unfit(f"{min(batch, len(cases))} test cases of at most {BATCH_BYTES_MAX} bytes together", largest)
    return found


def _unfit(case: TestCase, template: TestCase) -> Iterator[Unfit]:
    wanted, its = template.target, case.target
    if (wanted.name, wanted.build) != (its.name, its.build):
        yield Unfit(f"target and build {(wanted.name, wanted.build)}", (its.name, its.build))
    if its.settings != wanted.settings:  # planted defects among them
        yield Unfit("the target's settings as the campaign has them", its.settings)
    size_bytes, most_bytes = len(wire.encode(case)), max(TEST_CASE_BYTES_MAX, 2 * len(wire.encode(template)))
    if size_bytes > most_bytes:  # what is told to others must stay far below what a message may hold
        yield Unfit(f"a test case of at most {most_bytes} bytes", size_bytes)
    yield from _unwritable(case, template)


def _unwritable(case: TestCase, template: TestCase) -> Iterator[Unfit]:
    """What a test case keeps of files must be such files: what is found with it is written as files of that kind."""
    mission, usual = case.scenario.mission, template.scenario.mission
    try:
        if case.source not in ("", template.source):
            to_document(case)
        if mission is not None and mission.plan_extra not in ("{}", usual and usual.plan_extra):
            dump_plan(mission)
    except Refused as fault:
        yield Unfit("test cases that can be written as files", fault)
