"""Every export format, found by its place, takes any result and can be read back by an independent reader."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import pytest
import yaml

from saflite.contract.config import Campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import Judgement, Violation
from saflite.flight import autopilots
from saflite.flight.mission import builtin_mission
from saflite.oracle.policy import load_policy
from saflite.recorder import export
from saflite.recorder.exports.aerialist import read_case
from saflite.recorder.summary import Finding, PolicyFacts, Rulings, RunSummary

BOX = Obstacle(length_m=10.0, width_m=5.0, height_m=20.0, x_m=1.0, y_m=20.0, rotation_deg=30.0)
AVOID = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2"), obstacles=(BOX,)))
POLICY = TestCase(
    target=Target(),
    scenario=Scenario(start=StartState()),
    stimuli=(Stimulus(at_s=1.0, kind="command", name="MAV_CMD_DO_PARACHUTE", values=(2.0,)),),
)


def finding(case: TestCase, policy: str, confirmation: str = "confirmed", severity: str = "soft") -> Finding:
    violation = Violation(
        fingerprint=f"{policy}-1",
        test_case=identity(case),
        policy=policy,
        robustness=-0.5,
        severity=severity,  # type: ignore[arg-type]
        confirmation=confirmation,  # type: ignore[arg-type]
        reflown=1,
        failed_again=1,
        message='<odd & "text"> \x01 ]]> ünï',
    )
    judgement = Judgement(
        test_case=identity(case), flight_index=0, verdicts=(), features={"min_distance_m": 1.0, "duration_s": 80.0}
    )
    return Finding(violation, case, judgement, "recordings/x.mcap")


SUMMARY = RunSummary(
    campaign=Campaign(name="mine", mission="mission2"),
    policies=(
        PolicyFacts("min-obstacle-distance", "Keep away", "words", "source", Rulings(held=9, violated=1)),
        PolicyFacts("other", "", "", "", Rulings(held=1, vacuous=9)),
        PolicyFacts("silent", "", "", "", Rulings(vacuous=10)),
    ),
    findings=(
        finding(AVOID, "min-obstacle-distance", severity="hard"),
        finding(POLICY, "a-chute", confirmation="flaky"),
    ),
    flights=12,
    held=8,
    elapsed_s=3.5,
    version="0.1.0",
)
EMPTY = SUMMARY._replace(findings=(), policies=())


@pytest.mark.parametrize("name", export.format_names())
@pytest.mark.parametrize("summary", [SUMMARY, EMPTY])
def test_it_writes_the_files_it_names_and_the_same_ones_again(name: str, summary: RunSummary, tmp_path: Path) -> None:
    assert len(export.describe(name)) > 40
    written = export.export(name, summary, tmp_path)
    assert sorted(written) == sorted(path for path in tmp_path.rglob("*") if path.is_file())
    before = {path: path.read_bytes() for path in written}
    assert export.export(name, summary, tmp_path) == written
    assert before == {path: path.read_bytes() for path in written}


@pytest.mark.parametrize("kept", ["x", "[]", '{"simulation": 3, "mission": 3}', '{"saflite": 1, "_items_extra": 1}'])
@pytest.mark.parametrize("name", export.format_names())
def test_a_test_case_that_kept_no_file_keeps_no_other_from_being_written(name: str, kept: str, tmp_path: Path) -> None:
    mission = msgspec.structs.replace(builtin_mission("mission1"), plan_extra=kept)
    odd = (
        msgspec.structs.replace(AVOID, source=kept),
        msgspec.structs.replace(AVOID, scenario=msgspec.structs.replace(AVOID.scenario, mission=mission)),
    )
    findings = (*(finding(case, "min-obstacle-distance") for case in odd), *SUMMARY.findings)
    whole, some = (export.export(name, SUMMARY, tmp_path / part) for part in ("whole", "some"))
    written = export.export(name, SUMMARY._replace(findings=findings), tmp_path / "some")
    assert {path.name for path in written} >= {path.name for path in (*whole, *some)}
    for case in odd if name in ("yaml", "aerialist") else ():
        back = read_case(tmp_path / "some" / f"{identity(case)}.yaml")
        assert back.scenario.obstacles == case.scenario.obstacles
        assert back.scenario.mission is not None
        assert case.scenario.mission is not None
        assert back.scenario.mission.items == case.scenario.mission.items


@pytest.mark.parametrize("name", export.format_names())
def test_a_place_that_cannot_be_written_is_told(name: str, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(Unavailable, match="file"):
        export.export(name, SUMMARY, blocked)


def test_an_unknown_format_is_refused_with_the_choice(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="sarif"):
        export.export("word", SUMMARY, tmp_path)


def test_competition_files_give_the_test_cases_back(tmp_path: Path) -> None:
    written = [path for path in export.export("yaml", SUMMARY, tmp_path) if path.suffix == ".yaml"]
    assert {identity(read_case(path)) for path in written} == {identity(AVOID), identity(POLICY)}
    assert all(path.stem == identity(read_case(path)) for path in written)
    assert all(yaml.safe_load(path.read_text())["simulation"] for path in written)


def test_junit_counts_what_it_holds(tmp_path: Path) -> None:
    (path,) = export.export("junit", SUMMARY, tmp_path)
    suite = ElementTree.parse(path).getroot()
    tests = suite.findall("testcase")
    assert int(suite.attrib["tests"]) == len(tests) == 4
    assert int(suite.attrib["failures"]) == len(suite.findall("testcase/failure")) == 1
    assert int(suite.attrib["skipped"]) == len(suite.findall("testcase/skipped")) == 2
    assert [test.attrib["classname"] for test in tests if len(test) == 0] == ["other"]
    silent = suite.find("testcase[@classname='silent']/skipped")
    assert silent is not None
    assert silent.attrib["message"] == "vacuous: the rule never applied in 10 flights"
    failure = suite.find("testcase/failure")
    assert failure is not None
    assert '<odd & "text">' in failure.attrib["message"]


def test_sarif_results_name_rule_place_and_fingerprint(tmp_path: Path) -> None:
    (path,) = export.export("sarif", SUMMARY, tmp_path)
    log = json.loads(path.read_text())
    assert log["version"] == "2.1.0"
    run = log["runs"][0]
    rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
    counts = {rule["id"]: rule["properties"] for rule in run["tool"]["driver"]["rules"]}
    assert counts["silent"] == {"held": 0, "violated": 0, "vacuous": 10, "inconclusive": 0}
    assert [result["level"] for result in run["results"]] == ["error", "note"]
    for result in run["results"]:
        assert rules[result["ruleIndex"]] == result["ruleId"]
        assert result["partialFingerprints"]["saflite/v1"]
        assert result["message"]["text"]


LARGER = finding(AVOID, "min-obstacle-distance")
FORM = msgspec.structs.replace(AVOID, scenario=Scenario(mission=builtin_mission("mission2")))


def test_a_smallest_form_is_named_with_its_find_and_counted_by_nobody(tmp_path: Path) -> None:
    smaller = finding(FORM, "min-obstacle-distance")._replace(smallest_form_of=identity(AVOID))
    flaky = finding(POLICY, "min-obstacle-distance", "flaky")._replace(smallest_form_of=identity(AVOID))
    summary = SUMMARY._replace(findings=(smaller, LARGER, flaky))
    suite = ElementTree.parse(export.export("junit", summary, tmp_path)[0]).getroot()
    assert (suite.attrib["tests"], suite.attrib["failures"], suite.attrib["skipped"]) == ("3", "1", "1")
    text = suite.findtext("testcase/failure")
    assert text
    assert f"smallest form test_cases/{identity(FORM)}.yaml (confirmed)" in text
    (result,) = json.loads(export.export("sarif", summary, tmp_path)[0].read_text())["runs"][0]["results"]
    assert identity(AVOID) in json.dumps(result["locations"])
    assert [place["message"]["text"] for place in result["relatedLocations"]] == [
        "its smallest form (confirmed)",
        "its smallest form (flaky)",
    ]
    with export.export("csv", summary, tmp_path)[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["smallest_form_of"] for row in rows] == [identity(AVOID), "", identity(AVOID)]
    written = [path for path in export.export("yaml", summary, tmp_path) if path.suffix == ".yaml"]
    assert len(written) == 3, "all of them can be flown"


def test_a_smallest_form_without_its_find_counts(tmp_path: Path) -> None:
    """As where the find is withheld, or of another policy."""
    alone = finding(FORM, "a-chute")._replace(smallest_form_of=identity(AVOID))
    summary = SUMMARY._replace(findings=(LARGER, alone))
    suite = ElementTree.parse(export.export("junit", summary, tmp_path)[0]).getroot()
    assert suite.attrib["failures"] == "2"
    assert len(json.loads(export.export("sarif", summary, tmp_path)[0].read_text())["runs"][0]["results"]) == 2


def test_the_table_has_a_row_per_violation(tmp_path: Path) -> None:
    (path,) = export.export("csv", SUMMARY, tmp_path)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["policy"] for row in rows] == ["min-obstacle-distance", "a-chute"]
    assert rows[0]["min_distance_m"] == "1.0"
    assert "box 10x5x20" in rows[0]["inputs"]
    assert "MAV_CMD_DO_PARACHUTE 2" in rows[1]["inputs"]


@pytest.mark.parametrize(
    "script", ["px4/standalone/script.py", "ardupilot/standalone/script.py", "ardupilot/standalone/autotest_case.py"]
)
def test_the_log_of_a_script_is_judged_as_the_flight_was(script: str) -> None:
    """A hold soon after a take-off was ordered goes where that says; no flight of the farm begins so."""
    text = (Path(autopilots.__file__).parent / script).read_text(encoding="utf-8")
    names, values = next(
        (names.split(", "), values.split(", "))
        for names, values in re.findall(r"^([A-Z_, ]+) = ([\d., ]+?)(?:  #.*)?$", text, re.MULTILINE)
        if "SETTLE_S" in names.split(", ")
    )
    assert float(values[names.index("SETTLE_S")]) >= load_policy("px-hold1").file.constants["ordered_s"]
