"""What violated in the campaigns of `scripts/bench rq3` is flown again under other noise, as a farm confirms it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from _rq3_cell import Cell, Found, Row, campaign_of

from saflite.campaign.presets.campaigns import template
from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, TestCase, identity, under_noise
from saflite.oracle.judge import judge

REFLIGHTS, NEEDED = 3, 2


class Reflown(msgspec.Struct, frozen=True, kw_only=True):
    """One violation of a campaign, by the number of its flight: in how many re-flights it was violated again."""

    cell: Cell
    flight: int
    again: int
    reflights: int = REFLIGHTS

    @property
    def is_confirmed(self) -> bool:
        """Whether it failed again often enough."""
        return self.again >= NEEDED


def read(path: Path) -> list[Reflown]:
    """Return the re-flights in a file, none without it."""
    lines = path.read_bytes().splitlines() if path.exists() else []
    return [msgspec.json.decode(line, type=Reflown) for line in lines if line.strip()]


def reflights(rows: Sequence[Row], done: Sequence[Reflown]) -> Iterator[Reflown]:
    """Fly again what has not been flown again, in an order drawn once: however far it came, it is a fair sample."""
    known = {(one.cell, one.flight) for one in done}
    everything = [(row.cell, found) for row in rows for found in row.found]
    for place in derive(1, "rq3", "reflights").permutation(len(everything)):
        cell, found = everything[place]
        if (cell, found.flight) not in known:
            case = test_case(cell, found)
            again = sum(violates(under_noise(case, number)) for number in range(1, REFLIGHTS + 1))
            yield Reflown(cell=cell, flight=found.flight, again=again)


def test_case(cell: Cell, found: Found) -> TestCase:
    """Return what was flown."""
    base = template(campaign_of(cell))
    names = ("length_m", "width_m", "height_m", "x_m", "y_m", "rotation_deg")
    boxes = tuple(Obstacle(**dict(zip(names, numbers, strict=True))) for numbers in found.boxes)
    return msgspec.structs.replace(base, scenario=msgspec.structs.replace(base.scenario, obstacles=boxes))


def violates(case: TestCase) -> bool:
    """Fly a test case and return whether it violates."""
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    policies = ("min-obstacle-distance",)
    return any(verdict.outcome == "violated" for verdict in judge(case, flight, record.trace, policies).verdicts)
