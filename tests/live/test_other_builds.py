"""Regression as a user does it: two versions of one module, searched, flown again, compared, bisected."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.contract import modules

pytestmark = pytest.mark.live
EXAMPLES = Path(__file__).resolve().parents[2] / "deploy" / "examples" / "targets"


@pytest.fixture
def versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a campaign and four versions of a firmware: good, good, one that does not run, faulty."""
    monkeypatch.chdir(tmp_path)
    text = (EXAMPLES / "point_mass.py").read_text()
    good = text.replace('values["GAIN"] > 8.0', 'values["GAIN"] > 80.0')
    assert good != text
    for name, content in (("v1", good), ("v2", good + "# v2\n"), ("v3", "def describe(:"), ("v4", text)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "point_mass.py").write_text(content)
    for name in ("point-mass.toml", "point-mass-stays.toml"):
        (tmp_path / name).write_bytes((EXAMPLES / name).read_bytes())
    return tmp_path


def said(capsys: pytest.CaptureFixture[str], code: int, *words: str) -> list[dict[str, object]]:
    modules.forget()
    assert main([*words, "--json"]) == code, capsys.readouterr()
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_known_violations_on_other_versions(versions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = ("run", "point-mass.toml", "--out", "run", "--budget", "48", "--stop-at-first")
    (ended,) = said(capsys, 1, *run, "--module", "v4/point_mass.py")
    assert ended["confirmed"]
    old, new = ("--target", "v1/point_mass.py"), ("--target", "v4/point_mass.py")
    states = [one["state"] for one in said(capsys, 1, "regress", "run", *new)]
    assert set(states) == {"still there"}
    assert {one["state"] for one in said(capsys, 0, "compare", "run", "--all", *new)} == {"equal"}
    flies = said(capsys, 1, "compare", "run", "--all", *old)
    assert {"equal", "differs"} <= {one["state"] for one in flies}
    assert any("no longer violates point-mass-stays" in str(one["words"]) for one in flies)
    fixed = said(capsys, 0, "regress", "run", *old, "--corpus", "known", "--junit", "junit.xml")
    assert {one["state"] for one in fixed} == {"fixed"}
    assert 'failures="0"' in (versions / "junit.xml").read_text()
    back = said(capsys, 1, "regress", "known", *new, "--known-ok", "--sarif", "regress.sarif")
    assert {one["state"] for one in back} == {"came back"}
    one = next((versions / "known").glob("*.json"))
    row = [f"{name}/point_mass.py" for name in ("v1", "v2", "v3", "v4")]
    (found,) = said(capsys, 1, "bisect", str(one), *row)
    assert (found["change"], found["first"], found["last_before"], found["may_be_in"]) == (
        *("broke", row[3], row[1]),
        [row[2]],
    )
    (flake,) = said(capsys, 1, "flake", str(one), "-n", "5", *new)
    assert flake["policies"]["point-mass-stays"]["violated"] == 5  # type: ignore[index]


def test_only_what_is_new_is_reported(versions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--campaign", "point-mass.toml", "--budget", "48", "--workers", "2")
    (found,) = said(capsys, 1, "diff", "v1/point_mass.py", "v4/point_mass.py", *words, "--out", "ab")
    assert found["finds"]
    assert all(one["new"] for one in found["finds"])  # type: ignore[attr-defined]
    (same,) = said(capsys, 0, "diff", "v4/point_mass.py", "v4/point_mass.py", *words, "--out", "aa")
    assert same["behaviours"] == [1, 1]  # the one planted fault; its other finds are the same behaviour
    assert not any(one["new"] for one in same["finds"])  # type: ignore[attr-defined]


def test_a_run_ends_in_time(versions: Path, capsys: pytest.CaptureFixture[str]) -> None:
    policy = versions / "point-mass-stays.toml"
    text = policy.read_text().replace("far_m = 30.0", "far_m = 300.0").replace("place_m = -45", "place_m = -450")
    policy.write_text(text)  # the mass never gets that far: a quick machine finds a violation of the policy as it is
    assert "far_m = 300.0" in text
    words = ("run", "point-mass.toml", "--out", "run", "--budget", "100000", "--module", "v1/point_mass.py")
    (ended,) = said(capsys, 0, *words, "--minutes", "0.4")
    assert ended["ended"] is False
    assert "minutes are over" in str(ended["why"])
