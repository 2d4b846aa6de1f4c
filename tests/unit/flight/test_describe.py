"""What the reference target says of itself agrees with what it flies."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.contract import wire
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight import build
from saflite.flight.autopilots.reference.check import check_test_case
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.autopilots.reference.flight import ReferenceFlight


def test_every_start_state_is_taken() -> None:
    for start in describe().start_states:
        check_test_case(TestCase(target=Target(), scenario=Scenario(start=start)))


def test_defaults_lie_in_their_ranges_and_names_are_unique() -> None:
    info = describe()
    assert len({(entry.kind, entry.name) for entry in info.inputs}) == len(info.inputs)
    for entry in info.inputs:
        if entry.low is not None and entry.high is not None and entry.default is not None:
            assert entry.low <= entry.default <= entry.high, entry.name


def test_every_input_can_be_given() -> None:
    values = {"mode": (), "command": (0.0,) * 7}
    given = tuple(
        Stimulus(at_s=0.1, kind=entry.kind, name=entry.name, values=values.get(entry.kind, (entry.default or 0.0,)))
        for entry in describe().inputs
    )
    check_test_case(TestCase(target=Target(), scenario=Scenario(start=StartState()), stimuli=given))


def test_a_flight_writes_the_signals_described() -> None:
    case = TestCase(target=Target(), scenario=Scenario(start=StartState(), time_limit_s=0.5))
    trace = ReferenceFlight(case).run(lambda: False).trace
    assert trace is not None
    assert tuple(trace.signals) == describe().signals


def test_it_survives_the_wire() -> None:
    assert wire.decode(wire.encode(describe()), TargetInfo) == describe()


def test_the_build_counts_what_shapes_a_trace_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("vehicle.py", "native/sensors.c", "logs/ulog.py", "autopilots/one/a.py", "autopilots/two/b.py")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n")
    monkeypatch.setattr(build, "FLIGHT", tmp_path)

    def moved(*parts: str) -> set[str]:
        def built() -> str:
            build.build_of.cache_clear()
            return build.build_of("one", parts=parts)

        before, found = built(), set()
        for name in names:
            (tmp_path / name).write_text("2\n")
            if built() != before:
                found.add(name)
            (tmp_path / name).write_text("1\n")
        assert built() == before
        build.build_of.cache_clear()
        return found

    assert moved() == {"vehicle.py", "native/sensors.c", "autopilots/one/a.py"}
    assert moved("logs") == moved() | {"logs/ulog.py"}, (
        "an autopilot that is driven, or read, by what else reads flights"
    )
