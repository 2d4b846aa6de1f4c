"""The first day of somebody who knows PX4 but not this project, by the commands of the pages and nothing else."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import httpx
import pytest
import yaml
from real_logs import some_px4_log

pytestmark = pytest.mark.live
ROOT = Path(__file__).parents[2]
SAFLITE = [sys.executable, "-m", "saflite"]


def said(folder: Path, command: str, *codes: int) -> str:
    """Type a command; returns what it printed."""
    program, *words = command.split()
    assert program == "saflite"
    done = subprocess.run([*SAFLITE, *words], cwd=folder, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode in (codes or (0,)), (
        f"{command}: {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    )
    return done.stdout


def shown(page: str, command: str) -> str:
    """Return the command, which the page must show."""
    assert command in (ROOT / page).read_text(encoding="utf-8"), f"{page} does not show {command}"
    return command


def test_from_a_log_to_a_check_in_ci(tmp_path: Path) -> None:
    (tmp_path / "log.ulg").write_bytes(some_px4_log(tmp_path))

    # a real log is judged, and a rule of one's own is written and judged on it
    assert "  held " in said(tmp_path, shown("README.md", "saflite judge log.ulg"), 0, 1, 4)
    said(tmp_path, shown("deploy/docs/own-policy.md", "saflite new policy stays-below"))
    said(tmp_path, shown("deploy/docs/own-policy.md", "saflite judge log.ulg --policy stays-below.toml"), 0, 1, 4)

    # what breaks the rule is searched for, found, and repeats bit by bit
    search = shown("deploy/docs/own-policy.md", "saflite run stays-below.toml --budget 24")
    told = said(tmp_path, f"{search} --out runs/mine", 1)
    assert "what it takes" in told
    assert "no input at all" not in told, "found by where a flight began, not by what was given"
    found = json.loads(said(tmp_path, "saflite report runs/mine --json"))
    assert found["confirmed"] > 0
    fingerprint = found["findings"][0]["fingerprint"]
    assert "bit-equal" in said(tmp_path, "saflite replay runs/mine", 1)

    # it is seen in the browser
    words = shown("deploy/docs/dashboard.md", "saflite dashboard runs").split()[1:]
    served = subprocess.Popen([*SAFLITE, *words, "--port", "0"], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert served.stdout is not None
        address = served.stdout.readline().split()[1].rstrip("/")
        with httpx.Client(trust_env=False, timeout=60.0, follow_redirects=True) as browser:
            assert "stays-below" in browser.get(f"{address}/").text  # the only run there is
    finally:
        served.terminate()
        served.wait(60)

    # and it is a check in continuous integration, as the sample has it
    workflow = yaml.safe_load((ROOT / "deploy" / "ci" / "github-actions.yml").read_text(encoding="utf-8"))
    steps = [step.get("run", "") for step in workflow["jobs"]["regression"]["steps"]]
    check = next(step for step in steps if step.startswith("saflite regress"))
    assert "--known-ok" in check
    said(tmp_path, "saflite regress runs/mine --corpus saflite/known", 1)
    check = " ".join(check.split()).replace("--target saflite/firmware.py", "--target reference")
    said(tmp_path, check, 0)
    cases = ET.parse(tmp_path / "regress.xml").getroot().iter("testcase")
    assert any(fingerprint in (case.get("name") or "") + (case.get("classname") or "") for case in cases)
    assert json.loads((tmp_path / "regress.sarif").read_text())["runs"][0]["results"]
