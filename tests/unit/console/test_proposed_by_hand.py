"""What `saflite mutate` writes can be flown: a proposal that a farm refuses is refused by hand, too."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.console.operations import judging
from saflite.contract import modules

POLICY = Path(judging.__file__).parents[1] / "templates" / "policy.toml"
TEMPLATE = Path(judging.__file__).parents[1] / "templates" / "strategy.py"
ASKED = "return [self._next(rng) for _ in range(count)]"


@pytest.fixture(autouse=True)
def no_modules() -> Iterator[None]:
    yield
    modules.forget()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("stimuli=tuple(change(s, values=(float('nan'),)) for s in one.stimuli)", "expected a finite number, got nan"),
        ("stimuli=tuple(change(s, at_s=float('inf')) for s in one.stimuli)", "expected a finite number, got inf"),
        ("stimuli=tuple(change(s, values=None) for s in one.stimuli)", "$.test_cases[0].stimuli[0].values"),
        ("stimuli=tuple(change(s, values=(1e39,)) for s in one.stimuli)", "$.test_cases[0].stimuli[0].values"),
        ("target=change(one.target, build='another')", "expected target and build"),
        ("target=change(one.target, settings={'defects': ['d01']})", "expected the target's settings as the campaign"),
        ("source='{'", "expected test cases that can be written as files"),
    ],
)
def test_what_nobody_could_read_or_fly_is_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, told: str
) -> None:
    own = f"from msgspec.structs import replace as change\n        return [change(one, {change}) for one in ("
    text = TEMPLATE.read_text(encoding="utf-8").replace(ASKED, f"{own}self._next(rng) for _ in range(count))]")
    (tmp_path / "own.py").write_text(text.replace("NAME", "own"), encoding="utf-8")
    options = ["--strategy", "own", "--module", str(tmp_path / "own.py"), "--count", "2"]
    options += ["--out", str(tmp_path / "out")]
    assert main(["mutate", "policy-upright", *options]) == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.glob("out/*"))


def test_a_number_that_is_none_is_told_by_test_case_and_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = "from msgspec.structs import replace as change\n        found = [self._next(rng) for _ in range(count)]\n"
    own += "        one, values = found[1], (0.0, float('nan'))\n"
    own += "        last = change(one.stimuli[-1], kind='stick', name='RC3', values=values)\n"
    own += "        found[1] = change(one, stimuli=(last,))\n        return found"
    text = TEMPLATE.read_text(encoding="utf-8").replace(ASKED, own)
    (tmp_path / "own.py").write_text(text.replace("NAME", "own"), encoding="utf-8")
    options = ["--strategy", "own", "--module", str(tmp_path / "own.py"), "--count", "2"]
    assert main(["mutate", "policy-upright", *options]) == 2
    told = "test case 1 of the strategy (stimuli[0] (stick RC3).values[1]): expected a finite number, got nan"
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("part", "wrong", "told"),
    [
        ('altitude_m = "m"', 'altitude_m = "ft"', "unit"),
        ("armed == 1 implies", "armed = 1 implies", "formula"),
        ("altitude_m <=", "altitude_mm <=", "altitude_mm"),
        ("[10, 160]", "[10, 100]", "example"),
        ("always (armed == 1 implies altitude_m <= ceiling_m)", "always (ceiling_m <= 130)", "formula"),
        ('mode = "GUIDED"', 'mode = "GUIDEDX"', "GUIDEDX"),
    ],
)
def test_a_policy_that_a_campaign_refuses_is_refused_by_hand(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str, wrong: str, told: str
) -> None:
    right = POLICY.read_text(encoding="utf-8").replace("NAME", "ceiling")
    assert part in right
    (tmp_path / "right.toml").write_text(right, encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(right.replace(part, wrong), encoding="utf-8")
    mutate = ["--count", "1", "--out", str(tmp_path / "cases")]
    assert main(["run", str(tmp_path / "wrong.toml"), "--out", str(tmp_path / "run")]) == 2
    refused = capsys.readouterr().err
    assert told in refused
    assert main(["mutate", str(tmp_path / "wrong.toml"), *mutate]) == 2
    assert capsys.readouterr().err == refused
    assert main(["mutate", str(tmp_path / "right.toml"), *mutate]) == 0
    (case,) = tmp_path.glob("cases/*.json")
    capsys.readouterr()
    is_of_the_rule = "GUIDEDX" not in wrong  # where a search begins is no part of what the rule says
    assert main(["score", str(case), "--policy", str(tmp_path / "wrong.toml")]) == (2 if is_of_the_rule else 0)
    assert not is_of_the_rule or capsys.readouterr().err == refused
    assert main(["score", str(case), "--policy", str(tmp_path / "right.toml")]) == 0


def test_a_policy_that_there_is_not_is_refused_by_score(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(tmp_path / "case.json"), "--policy", "min-obstacle-distanc"]) == 2
    assert "did you mean min-obstacle-distance?" in capsys.readouterr().err
