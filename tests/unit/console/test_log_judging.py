"""`saflite judge` on logs: what a log does not tell is said, nothing judged is never "fine", folders are tables."""

from __future__ import annotations

import csv
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "flight"))

from log_bytes import KINDS, ardupilot_flight, dataflash

from saflite.console.cli import main
from saflite.console.operations.log_judging import judge_folder
from saflite.flight.logs.dataflash import read_dataflash_log

HEAD = "t_s,x,y,z,vx,vy,vz,roll_deg,pitch_deg,yaw_deg,nav_state,arming_state,landed\n"


def extract(path: Path, tilt_deg: float = 5.0, armed: int = 2) -> Path:
    rows = (f"{at / 2},0,0,-10,0,0,0,{tilt_deg},0,0,2,{armed},0\n" for at in range(60))
    path.write_text(HEAD + "".join(rows))
    return path


def test_upright_needs_no_parachute_in_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # extracts count heights from the first one, so a second log climbs
    path = tmp_path / "log.csv"
    rows = (f"{at / 2},0,0,{-at},0,0,0,{90 if at > 30 else 0},0,0,2,2,0\n" for at in range(60))
    path.write_text(HEAD + "".join(rows))
    assert main(["judge", str(path), "--policy", "upright", "--json"]) == 1
    (verdict,) = json.loads(capsys.readouterr().out)["verdicts"]
    assert (verdict["policy"], verdict["outcome"]) == ("upright", "violated")


def test_without_obstacles_their_distance_is_inconclusive_and_nothing_judged_is_told_aloud(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["judge", str(extract(tmp_path / "log.csv")), "--policy", "min-obstacle-distance", "--all"]) == 4
    said = capsys.readouterr()
    assert "no obstacles are known; name them with --test-case" in said.out
    assert "NOTHING JUDGED" in said.err


def test_settings_that_a_log_does_not_tell_are_missing_not_usual(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["judge", str(extract(tmp_path / "log.csv")), "--policy", "speed-limit", "--json"]) == 4
    (verdict,) = json.loads(capsys.readouterr().out)["verdicts"]
    assert verdict["outcome"] == "inconclusive"
    assert "cruise_speed_set_mps" in verdict["message"]


@pytest.mark.parametrize(
    ("policy", "lacks"), [("arming-has-order", "order_quiet_s"), ("mode-has-cause", "mode_cause_s")]
)
def test_what_a_stick_or_switch_ordered_is_not_taken_for_no_order(
    policy: str, lacks: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Armed by the stick, then another mode by the switch, as most pilots do it; a log tells neither as an order."""
    path = tmp_path / "flight.bin"
    rows: list[tuple[str, tuple[Any, ...]]] = [("MODE", (1_000_000, 5, 5, 1)), ("EV", (1_000_000, 11))]
    for tenth in range(200):
        at = 1_000_000 + tenth * 100_000
        rows.append(("XKF1", (at, 0, 0.0, 0.0, -0.01 * tenth, 0.0, 0.0, -0.1)))
        if tenth == 30:
            rows += [("EV", (at, 10)), ("EV", (at, 28))]
        elif tenth == 120:
            rows.append(("MODE", (at, 2, 2, 1)))
    path.write_bytes(dataflash(KINDS, rows))
    assert main(["judge", str(path), "--policy", policy, "--json"]) == 4
    (verdict,) = json.loads(capsys.readouterr().out)["verdicts"]
    assert (verdict["outcome"], lacks in verdict["message"]) == ("inconclusive", True)


def test_commands_are_known_where_the_autopilot_logs_them(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight())
    assert "command_quiet_s" in read_dataflash_log(path).untold
    path.write_bytes(ardupilot_flight({**KINDS, "MAVC": ("QHf", "TimeUS,Cmd,P1")}))
    assert "command_quiet_s" not in read_dataflash_log(path).untold


def test_a_folder_is_a_table_a_csv_file_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "logs"
    (folder / "deeper").mkdir(parents=True)
    extract(folder / "deeper" / "one.csv")
    (folder / "notes.csv").write_text("a,b\n1,2\n")
    (folder / "bad.ulg").write_bytes(b"no log")
    table, page = tmp_path / "out.csv", tmp_path / "out.html"
    words = ["judge", str(folder), "--policy", "armed-in-flight", "--policy", "upright"]
    assert main([*words, "--csv", str(table), "--html", str(page)]) == 2
    out = capsys.readouterr().out
    assert "bad.ulg" in out
    assert "one.csv" in out
    assert "notes.csv" not in out
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert {(Path(row["log"]).name, row["outcome"]) for row in rows} >= {("bad.ulg", "refused")}
    assert "bad.ulg" in page.read_text()
    assert main([*words, "--csv", str(table)]) == 2, "never over a file that is there"


def test_quiet_prints_what_is_wrong_and_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log.csv"
    rows = (f"{at / 2},0,0,{-at},0,0,0,{90 if at > 30 else 0},0,0,2,2,0\n" for at in range(60))
    path.write_text(HEAD + "".join(rows))
    assert main(["judge", str(path), "--policy", "upright", "-q"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert "upright -" in lines[0]
    assert lines[1] == "1 violated"


def test_a_folder_holds_what_begins_as_a_log_whatever_its_name(tmp_path: Path) -> None:
    (tmp_path / "00000042.log").write_bytes(ardupilot_flight())
    (tmp_path / "flight").write_bytes(ardupilot_flight())
    (tmp_path / "notes.txt").write_text("no log")
    extract(tmp_path / "TABLE.CSV")
    (tmp_path / "OTHER.CSV").write_text("a,b\n1,2\n")
    told = [(one.path.name, one.refused) for one in judge_folder(tmp_path, None, ("upright",))]
    assert told == [("00000042.log", ""), ("TABLE.CSV", ""), ("flight", "")]


def test_an_unknown_policy_is_refused_once_not_by_every_log_of_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a.csv", "b.csv"):
        extract(tmp_path / name)
    assert main(["judge", str(tmp_path), "--policy", "uprigt"]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("did you mean upright?")) == ("", 1)


def test_a_recording_is_known_by_capitals_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "X.MCAP"
    path.write_bytes(b"no recording")
    assert main(["judge", str(path)]) == 2
    assert ".trace, .ulg" not in capsys.readouterr().err


def test_a_log_by_a_name_that_is_no_text_is_told_in_every_form_beside_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    extract(logs / "a.csv")
    extract(logs / os.fsdecode(b"\xff.csv"))
    told = ["--csv", str(tmp_path / "told.csv"), "--html", str(tmp_path / "told.html")]
    assert main(["judge", str(logs), "--policy", "upright", "--json", *told]) == 4
    files = [one["file"] for one in json.loads(capsys.readouterr().out)]
    assert files == [f"{logs}/a.csv", f"{logs}/\\udcff.csv"]
    for file in ("told.csv", "told.html"):
        assert "\\udcff.csv" in (tmp_path / file).read_text()
