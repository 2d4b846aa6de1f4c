"""A recording needs nothing else: a rule of one's own that it was judged by travels in it."""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.policy_campaigns import policy_text
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.operations.log_judging import judge_file
from saflite.contract.flight import pack_trace
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import PolicyText, RecordWork
from saflite.recorder import mcap, recording

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import doubles

LOW = """id = "stay-low"
title = "Stay below the ceiling"
source = "our own flight manual"
interestingness = "The vehicle must stay below the ceiling."
formula = "always (time_s >= 1 implies altitude_m <= ceiling_m)"
constants = { ceiling_m = 5.0 }
signals = { altitude_m = "m", time_s = "s" }

[[examples]]
holds = true
why = "so"
duration_s = 5.0
signals = { altitude_m = 4 }

[[examples]]
holds = false
why = "so"
duration_s = 5.0
signals = { altitude_m = [[0, 4], [3, 6]] }
"""
CASE = TestCase(
    target=Target(),
    scenario=Scenario(start=StartState(mode="ALT_HOLD", altitude_m=20.0), time_limit_s=4.0),
    stimuli=(Stimulus(at_s=1.0, kind="mode", name="LOITER"),),
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording judged by a rule whose file has gone since."""
    folder = tmp_path_factory.mktemp("recorded")
    case, rule, file = folder / "case.json", folder / "low.toml", folder / "flight.mcap"
    case.write_bytes(msgspec.json.encode(CASE))
    rule.write_text(LOW)
    assert main(["fly", str(case), "--policy", str(rule), "--out", str(file), "--json"]) == 1
    rule.unlink()
    return file


@pytest.mark.parametrize(
    "words",
    [
        ["judge"],
        ["judge", "--policy", "stay-low"],
        ["fly"],
        ["fly", "--policy", "stay-low"],
        ["replay"],
        ["flake", "-n1"],
    ],
    ids=" ".join,
)
def test_its_rules_are_judged_by_without_their_files(
    words: list[str], recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, str(recorded)]) == 1
    assert "stay-low" in capsys.readouterr().out


def test_a_test_case_in_a_run_folder_is_flown_by_the_rules_of_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "low.toml").write_text(LOW)
    name, text = policy_text(tmp_path / "low.toml")
    campaign = msgspec.structs.replace(doubles.campaign(4), policies=(name,), policy_texts={name: text})
    Store.create(tmp_path / "run", campaign, CASE, doubles.TARGET).close()
    case = tmp_path / "run" / "test_cases" / "case.json"
    case.parent.mkdir()
    case.write_bytes(msgspec.json.encode(CASE))
    assert main(["fly", str(case)]) == 1
    assert "VIOLATED  stay-low" in capsys.readouterr().out
    (tmp_path / "run" / "books.sqlite").write_bytes(b"damaged")
    assert main(["fly", str(case)]) == 0


def test_why_nothing_was_judged_is_told(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A signal that no trace holds, such as a mistyped one, must not read as a rule that never applied."""
    rule = tmp_path / "armd.toml"
    text = (
        LOW.replace("stay-low", "mistyped").replace("time_s >= 1", "armd == 1").replace('time_s = "s"', 'armd = "flag"')
    )
    rule.write_text(
        text.replace("{ altitude_m = 4 }", "{ altitude_m = 4, armd = 1 }").replace("6]] }", "6]], armd = 1 }")
    )
    assert main(["judge", str(recorded), "--policy", str(rule)]) == 4
    assert "of 1 policies none was. Why: the trace holds no armd: 1" in capsys.readouterr().err
    assert main(["judge", str(recorded), "--policy", "a-chute"]) == 4
    assert "none was. Why: the rule never applied: 1" in capsys.readouterr().err


def test_a_flight_to_which_no_rule_applied_is_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = tmp_path / "case.json"
    case.write_bytes(msgspec.json.encode(CASE))
    assert main(["fly", str(case), "--policy", "a-chute"]) == 4
    assert "NOTHING JUDGED: of 1 policies none was. Why: the rule never applied: 1" in capsys.readouterr().err
    assert main(["fly", str(case), "--policy", "a-chute", "--policy", "upright"]) == 0
    assert capsys.readouterr().err == ""


def test_one_that_ships_is_judged_by_as_it_ships(recorded: Path, tmp_path: Path) -> None:
    """A recording of others cannot say that a rule which ships means something else."""
    found = recording.read(recorded)
    own = found.policy_texts["stay-low"]
    texts = {"upright": PolicyText(file="upright.toml", text=own.text)}
    work = RecordWork(test_case=found.test_case, flight=found.flight, judgement=found.judgement, policy_texts=texts)
    file = tmp_path / "flight.mcap"
    file.write_bytes(mcap.write(work, pack_trace(found.trace), 0.0))
    told = judge_file(file, None, ()).verdicts
    assert [one.outcome for one in told if one.policy == "upright"] == ["held"]
    assert "stay-low" not in {one.policy for one in told}


def test_one_that_names_a_file_of_this_machine_is_not_replayed(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = recording.read(recorded)
    verdict = msgspec.structs.replace(found.judgement.verdicts[0], policy="rule.toml")
    judgement = msgspec.structs.replace(found.judgement, verdicts=(verdict,))
    file = tmp_path / "flight.mcap"
    work = RecordWork(test_case=found.test_case, flight=found.flight, judgement=judgement)
    file.write_bytes(mcap.write(work, pack_trace(found.trace), 0.0))
    for words in (["replay"], ["flake", "-n", "1"]):
        assert main([*words, str(file)]) == 2
        assert "the name of a file" in capsys.readouterr().err


def test_the_recording_of_a_flight_by_rules_that_ship_carries_none(tmp_path: Path) -> None:
    case, file = tmp_path / "case.json", tmp_path / "flight.mcap"
    case.write_bytes(msgspec.json.encode(CASE))
    main(["fly", str(case), "--policy", "upright", "--out", str(file), "--json"])
    assert recording.read(file).policy_texts == {}
