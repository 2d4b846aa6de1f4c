"""The comparison of two checkouts: who is asked, in which order, and what counts as slower."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts" / "benches"))

from _flight_against import KINDS, Compared, compare, show, slower

BENCH = """
import os, time
def noted(word, ends_after_s):
    with open(PLACE.parent / "asked", "a") as log:
        print(PLACE.name, word, os.environ["PYTHONPATH"], file=log)
    end = time.process_time() + ends_after_s
    while time.process_time() < end:
        pass
    print("chatter")
    return 10.0, 0.0
def layouts(count): return [()] * count
def bare(): return noted("bare", 0.001)
def mission_case(name, boxes, i): return "avoidance"
def policy_case(i): return "policy"
def fly(case): return noted(case, SLOW_S if case == "policy" else 0.001)
def kinematic(boxes, i): return noted("kinematic", 0.001)
"""


def checkout(folder: Path, name: str, slow_s: float = 0.001) -> Path:
    """A checkout whose flights take a known time and note that they were asked for."""
    made = folder / name
    (made / "scripts" / "benches").mkdir(parents=True)
    (made / "services" / "native").mkdir(parents=True)
    (made / "services" / "native" / "_native.so").touch()
    head = f"from pathlib import Path\nPLACE, SLOW_S = Path({str(made)!r}), {slow_s}\n"
    (made / "scripts" / "benches" / "flight.py").write_text(head + BENCH)
    return made


def test_checkouts_fly_in_turns_on_their_own_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours, theirs = checkout(tmp_path, "ours"), checkout(tmp_path, "theirs", slow_s=0.05)
    compared = compare(ours, theirs, turns=3)
    asked = [line.split() for line in (tmp_path / "asked").read_text().splitlines()]
    policy = [place for place, word, _ in asked if word == "policy"]
    assert policy == ["ours", "theirs", "theirs", "ours", "ours", "theirs", "theirs", "ours"]
    assert all(path == str(tmp_path / place / "services") for place, _, path in asked)
    assert {name: len(row.ratios) for name, row in compared.items()} == dict.fromkeys(KINDS, 3)
    assert min(compared["policy"].ratios) > 5.0
    show(compared)
    assert "in 3 turns" in capsys.readouterr().out


def test_only_flights_can_be_slower() -> None:
    rows = {"bare": Compared(1.0, 2.0, (0.5,)), "policy": Compared(9.6, 10.0, (0.9, 0.96, 1.2))}
    assert slower(rows, 0.97) == ["policy: 0.960"]
    assert slower(rows, 0.95) == []


def test_a_checkout_that_cannot_measure_itself_ends_it_with_its_words(tmp_path: Path) -> None:
    broken = checkout(tmp_path, "broken")
    (broken / "scripts" / "benches" / "flight.py").write_text("raise RuntimeError('no JSBSim here')")
    with pytest.raises(SystemExit, match="no JSBSim here"):
        compare(broken, broken, turns=1)
