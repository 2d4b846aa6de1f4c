"""The main job end to end as a user runs it: real processes, real bus, real simulator."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from saflite.recorder import recording

pytestmark = pytest.mark.live
SAFLITE = [sys.executable, "-m", "saflite"]
FOUND, STOPPED_CLEAN = 1, (0, 1, 4)  # 4: stopped before a flight was judged
CAMPAIGN = """
name = "chute-in-acro"
description = "The one command that opens the parachute, given again and again in the mode in which it must not open"
policies = ["a-chute"]
budget_flights = 40
time_limit_s = 20.0

[target.parameters]
CHUTE_ENABLED = 1
CHUTE_TYPE = 10
SERVO9_FUNCTION = 27
SIM_PARA_ENABLE = 1

[start]
mode = "ACRO"
altitude_m = 50.0

[strategy]
name = "pgfuzz"

[strategy.settings]
commands = ["MAV_CMD_DO_PARACHUTE"]
sticks = ["RC3"]

[scorer]
model = "random"

[search]
candidates_per_round = 16
flights_per_round = 8
"""
"""No luck is needed: releasing is one of three values of the only command, and every release there breaks the rule."""


def saflite(*words: str, limit_s: float = 240.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*SAFLITE, *words], capture_output=True, text=True, timeout=limit_s, check=False)


def parachute(run_dir: Path, *more: str) -> list[str]:
    file = run_dir.parent / "chute-in-acro.toml"
    file.write_text(CAMPAIGN, encoding="utf-8")
    return ["run", str(file), "--defect", "parachute-in-acro", "--out", str(run_dir), "--json", *more]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("live") / "run"
    done = saflite(*parachute(folder))
    assert done.returncode == FOUND, done.stdout + done.stderr
    said = json.loads(done.stdout)
    assert said["ended"]
    assert said["flights"] <= 40
    assert said["confirmed"] >= 1
    return folder


def test_every_violation_repeats_bit_by_bit(run_dir: Path) -> None:
    done = saflite("replay", str(run_dir), "--json")
    assert done.returncode == FOUND, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert rows
    assert all(row["bit_equal"] for row in rows)
    assert all(row["violated"] == ["a-chute"] for row in rows)


def test_the_run_folder_holds_what_people_need(run_dir: Path) -> None:
    assert (run_dir / "report.html").stat().st_size > 10_000
    recordings = sorted((run_dir / "recordings").glob("*.mcap"))
    assert recordings
    for path in recordings:
        assert recording.verify(path) > 20, "samples on a line between others are left out"
    assert sorted((run_dir / "test_cases").glob("*.yaml"))
    assert saflite("audit", str(run_dir), "--json").returncode == 0


def test_a_recording_is_judged_as_the_farm_judged_it(run_dir: Path) -> None:
    path = next((run_dir / "recordings").glob("*.mcap"))
    done = saflite("judge", str(path), "--policy", "a-chute", "--json")
    assert done.returncode == FOUND, done.stderr
    stored = recording.read(path).judgement.verdicts
    assert json.loads(done.stdout)["verdicts"][0]["robustness"] == stored[0].robustness


def test_a_test_case_file_flies_as_in_the_campaign(run_dir: Path) -> None:
    path = next((run_dir / "test_cases").glob("*.yaml"))
    done = saflite("fly", str(path), "--policy", "a-chute", "--json")
    assert done.returncode == FOUND, done.stderr
    flight = json.loads(done.stdout)["flight"]
    recorded = recording.read(run_dir / "recordings" / f"{path.stem}-0.mcap").flight
    assert flight["trace_digest"] == recorded.trace_digest


def test_one_rng_seed_finds_the_same_at_any_number_of_workers(run_dir: Path, tmp_path: Path) -> None:
    done = saflite(*parachute(tmp_path / "run", "--workers", "1"))
    assert done.returncode == FOUND, done.stderr

    def found(folder: Path) -> set[str]:
        said = saflite("watch", str(folder), "--kind", "violation", "--json").stdout.splitlines()
        return {json.loads(line)["fact"]["violation"]["fingerprint"] for line in said}

    assert found(tmp_path / "run") == found(run_dir)


def test_stopped_by_the_keyboard_it_goes_on_with_an_exact_budget(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    process = subprocess.Popen(
        [*SAFLITE, *parachute(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    until_s = time.monotonic() + 60.0
    while not (folder / "farm.json").exists() and time.monotonic() < until_s:
        time.sleep(0.05)
    assert (folder / "farm.json").exists(), "it never started"
    os.kill(process.pid, signal.SIGINT)
    said, told = process.communicate(timeout=60)
    assert process.returncode in STOPPED_CLEAN
    assert "signal SIGINT: stopping; what is under way is handed back" in told
    stopped = json.loads(said)
    assert not stopped["ended"] or stopped["flights"] == 40
    done = saflite("resume", str(folder), "--json")
    assert done.returncode == FOUND, done.stderr
    ended = json.loads(done.stdout)
    assert ended["ended"]
    assert stopped["flights"] <= ended["flights"] <= 40
    assert saflite("audit", str(folder)).returncode == 0


def test_the_doctor_finds_nothing_bad() -> None:
    done = saflite("doctor", "--json")
    assert done.returncode == 0, done.stdout
