"""Target `aerialist` against its documented command line; the image itself is not at hand."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
import pytest

from saflite.conformance.flying import opened
from saflite.conformance.kit import findings
from saflite.conformance.targets import checks_of
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.test_case import Obstacle, Scenario, Stimulus, Target, TestCase, Wind
from saflite.flight.autopilots.aerialist import bench, container
from saflite.flight.mission import builtin_mission
from saflite.simulator_worker.targets import aerialist

ENGINE = Path(__file__).with_name("container_engine.py")
BOX = Obstacle(length_m=4.0, width_m=4.0, height_m=10.0, x_m=0.0, y_m=10.0, rotation_deg=0.0)
SCENARIO = Scenario(mission=builtin_mission("mission2"), obstacles=(BOX,), time_limit_s=60.0)
CASE = TestCase(target=Target(name="aerialist"), scenario=SCENARIO)


@pytest.fixture
def containers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the containers of an engine that is here."""
    program = tmp_path / "engine"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {ENGINE} "$@"\n')
    program.chmod(0o755)
    root = tmp_path / "containers"
    root.mkdir()
    monkeypatch.setenv("SAFLITE_CONTAINER_ENGINE", str(program))
    monkeypatch.setenv("STANDIN_ROOT", str(root))
    monkeypatch.setenv("SAFLITE_SLOTS", str(tmp_path / "slots"))
    return root


def flown(case: TestCase, deadline_s: float = 60.0) -> FlightRecord:
    with opened(aerialist) as session:
        return session.fly(case, deadline_s, lambda: False)


def test_a_flight_is_its_log_with_contact_from_the_boxes(containers: Path) -> None:
    record = flown(CASE)
    assert record.ending == "completed"
    assert record.trace is not None
    assert set(record.trace.signals) == set(bench.SIGNALS)
    touching = record.trace.array("contact") > 0
    along = record.trace.array("y_m")
    assert along[touching].min() == pytest.approx(8.4, abs=0.06)  # the solid core is 0.8 of the seen box
    assert along[touching].max() == pytest.approx(11.6, abs=0.06)
    assert [name for name, _ in record.artefacts] == ["console.txt", "flight.ulg"]
    assert list(containers.iterdir()) == []


def test_a_flight_still_armed_at_the_end_ran_out_of_time(containers: Path) -> None:
    case = msgspec.structs.replace(CASE, scenario=msgspec.structs.replace(SCENARIO, time_limit_s=15.0))
    assert flown(case).ending == "timed_out"


@pytest.mark.live
@pytest.mark.usefixtures("containers")
def test_the_target_keeps_what_targets_promise() -> None:
    assert findings(checks_of(aerialist)) == []


@pytest.mark.parametrize("words", ["nothing of a log", "LOG:", "LOG:/src/ros/another.ulg"])
def test_a_flight_without_a_log_is_no_finding(containers: Path, monkeypatch: pytest.MonkeyPatch, words: str) -> None:
    monkeypatch.setenv("STANDIN_WORDS", words)
    with pytest.raises(Unavailable, match=r"nothing of a log|named no log|another\.ulg"):
        flown(CASE)
    assert list(containers.iterdir()) == []


def test_a_log_that_is_a_link_is_none_of_the_flight(
    containers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine copies a link as one: what the container named was read, and kept, from this machine."""
    monkeypatch.setenv("STANDIN_LINK", str(tmp_path / "a log of this machine"))
    with pytest.raises(Unavailable, match="a link in the container"):
        flown(CASE)
    assert list(containers.iterdir()) == []


def test_of_what_is_printed_the_end_alone_is_read(tmp_path: Path) -> None:
    console = tmp_path / "console.txt"
    with console.open("wb") as file:
        file.truncate(2**40)
        file.seek(2**40)
        file.write(b"LOG:/src/ros/log.ulg")
    assert bench._tail(console).endswith(b"LOG:/src/ros/log.ulg")
    assert len(bench._tail(console)) == container.OUTPUT_BYTES_MAX


def test_a_flight_without_an_end_is_wedged_and_leaves_nothing(
    containers: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STANDIN_HANGS", "1")
    assert flown(CASE, deadline_s=3.0).ending == "wedged"
    assert list(containers.iterdir()) == []


def test_without_engine_or_image_it_says_what_to_do(containers: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAFLITE_AERIALIST", "no/such:image")
    assert "pull no/such:image" in aerialist.describe().missing
    monkeypatch.setenv("SAFLITE_CONTAINER_ENGINE", str(containers / "none"))
    assert "on the path" in aerialist.describe().missing
    with pytest.raises(Unavailable, match="SAFLITE_CONTAINER_ENGINE"):
        flown(CASE)


@pytest.mark.parametrize(
    ("case", "word"),
    [
        (TestCase(target=Target(name="aerialist"), scenario=Scenario(obstacles=(BOX,))), "mission"),
        (msgspec.structs.replace(CASE, scenario=msgspec.structs.replace(SCENARIO, obstacles=(BOX,) * 5)), "obstacles"),
        (msgspec.structs.replace(CASE, scenario=msgspec.structs.replace(SCENARIO, wind=Wind(mean_mps=3.0))), "wind"),
        (msgspec.structs.replace(CASE, scenario=msgspec.structs.replace(SCENARIO, time_limit_s=1e4)), "time_limit_s"),
        (msgspec.structs.replace(CASE, target=Target(name="aerialist", parameters={"MPC_XY_CRUISE": 3.0})), "param"),
        (msgspec.structs.replace(CASE, stimuli=(Stimulus(at_s=1.0, kind="mode", name="LAND"),)), "stimulus"),
    ],
)
def test_what_its_test_file_has_no_words_for_is_refused(case: TestCase, word: str) -> None:
    with pytest.raises(Refused, match=word):
        aerialist.check(case)
