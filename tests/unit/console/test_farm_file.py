"""The file `saflite up` takes: read whole or refused, by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.console.io.farm_file import read_farm_file
from saflite.contract.errors import Refused

GOOD = 'campaign = "night.toml"\nrun = "runs/night"\nkeys = "keys"\n[workers]\nfly = 2\n'


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "farm.toml").write_text(GOOD)
    farm = read_farm_file(tmp_path / "farm.toml")
    assert (farm.campaign, farm.run) == (str(tmp_path / "night.toml"), str(tmp_path / "runs/night"))
    assert (farm.keys, dict(farm.workers), farm.listen) == (str(tmp_path / "keys"), {"fly": 2}, "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "campaign"),
        (GOOD + "swim = 1\n", "swim"),
        (GOOD.replace("2", "-1"), "workers.fly"),
        (GOOD.replace("2", '"two"'), "workers"),
        ("port = 1\n" + GOOD, "port"),
        (GOOD + "[scale]\nfly = { min = 0, max = 2 }\n", "not in `workers`"),
        (GOOD + "[scale]\njudge = { min = 3, max = 2 }\n", "min 3, max 2"),
        (GOOD + "[scale]\njudge = { min = -1, max = 2 }\n", "min -1, max 2"),
        (GOOD + "[scale]\npilot = { min = 1, max = 2 }\n", r"`scale\.pilot` is unknown \(one of .*judge"),
        (GOOD.replace("fly", "fli"), r"`workers\.fli` is unknown \(one of .*fly"),
        ('lisen = "x"\n' + GOOD, r"`lisen` is unknown \(`listen`\?\)"),
        (GOOD + "[scale]\njudge = { min = 1, most = 2 }\n", "most"),
        (GOOD + "[scale]\njudge = 2\n", "scale"),
        ("campaign = [", "TOML"),
    ],
)
def test_what_is_no_farm_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "farm.toml").write_text(text)
    with pytest.raises(Refused, match=words):
        read_farm_file(tmp_path / "farm.toml")


@pytest.mark.parametrize(
    "text",
    [
        GOOD,  # no such campaign
        'campaign = "avoidance-m2"\nrun = "r"\nlisten = "tcp/0.0.0.0:7447"\n',
        'campaign = "avoidance-m2"\nrun = "r"\nlisten = "tls/0.0.0.0:7447"\nkeys = "none"\n',
        'campaign = "avoidance-m2"\nrun = "r"\nmetrics = "nowhere"\n',
        'campaign = "avoidance-m2"\nrun = "r"\nmodules = ["none.py"]\n',
    ],
)
def test_up_refuses_before_anything_is_made(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "farm.toml").write_text(text)
    assert main(["up", str(tmp_path / "farm.toml")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["farm.toml"]
