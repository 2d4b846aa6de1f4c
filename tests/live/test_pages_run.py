"""Whoever types what the pages show gets no error: each of their commands that needs no other machine is run here."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tidy"))
sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "flight"))

from log_bytes import px4_flight
from page_commands import PageCommand, commands
from page_runs import PLACES, RUNS

pytestmark = pytest.mark.live
FIRST, LAST = ("saflite new ",), ("saflite run ", "saflite conformance ", "saflite regress ", "saflite flake ")
SHOWN = sorted(
    {command.text: command for command in commands() if command.text in RUNS}.values(),
    key=lambda command: command.text.startswith(LAST) - command.text.startswith(FIRST),
)
"""Each once, files of one's own first: pages take for granted what other pages make."""

SAFLITE = [sys.executable, "-m", "saflite"]


def said(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*SAFLITE, *words], cwd=folder, capture_output=True, text=True, timeout=600, check=False)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the pages take for granted: a run, a case, a log, a policy and a campaign of one's own."""
    folder = tmp_path_factory.mktemp("pages")
    assert (
        said(
            folder, "run", "avoidance-m2", "--budget", "12", "--rng-seed", "1", "--out", "runs/avoidance-m2"
        ).returncode
        == 1
    )
    shutil.copytree(folder / "runs" / "avoidance-m2", folder / "runs" / "night")
    case = next((folder / "runs" / "avoidance-m2" / "test_cases").glob("*.yaml"))
    shutil.copytree(case.parent, folder, dirs_exist_ok=True)
    shutil.copy(case, folder / "case.yaml")
    (folder / "logs").mkdir()
    for log in (folder / "log.ulg", folder / "logs" / "log.ulg"):
        log.write_bytes(px4_flight())
    for kind, name in (("policy", "my-policy"), ("campaign", "my-campaign")):
        assert said(folder, "new", kind, name).returncode == 0
    return folder


@pytest.mark.parametrize("command", SHOWN, ids=lambda command: command.text)
def test_what_a_page_shows_runs(place: Path, command: PageCommand) -> None:
    run = RUNS[command.text]
    words = [PLACES.get(word, word) for word in command.words[1:]]
    done = said(place, *words, *run.more)
    assert done.returncode in run.codes, f"{done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    assert "Traceback" not in done.stderr
