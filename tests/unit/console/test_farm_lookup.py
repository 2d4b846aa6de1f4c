"""Which farm a command means: files that are damaged or that others wrote keep no other from being found."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.run_data import farm_lookup
from saflite.console.view.dashboard.source import RunSource
from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime import farm_register
from saflite.runtime.client import FARM_FILE, FarmClient, FarmInfo, read_info, write_info

DAMAGED = (
    b"",
    b"{",
    b'{"campaign": "x"}',
    b"\xff\xfe",
    b"[" * 100_000,
    b'{"campaign": "x", "endpoint": "y", "pid": 0}',
)
TCP = FarmInfo(campaign="night", endpoint="tcp/127.0.0.1:9", insecure=True, pid=os.getpid())


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def run_dir(here: Path, name: str) -> Path:
    campaign = load_campaign("avoidance-m2")
    Store.create(here / "runs" / name, campaign, template(campaign), describe()).close()
    return Path("runs") / name


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_file_keeps_no_other_farm_from_being_found(content: bytes, here: Path) -> None:
    works, damaged = run_dir(here, "works"), run_dir(here, "damaged")
    write_info(works, TCP)
    (damaged / FARM_FILE).write_bytes(content)
    os.utime(damaged / FARM_FILE, (2**31, 2**31))  # the newest
    assert farm_lookup.newest_running() == works
    assert farm_lookup.newest(None) == works
    assert farm_lookup.newest_at_rest(None) == damaged


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_file_alone_is_no_farm(content: bytes, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damaged = run_dir(here, "damaged")
    (damaged / FARM_FILE).write_bytes(content)
    assert main(["control", "status"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert main(["control", "status", "runs/damaged"]) == 2
    for words in (["audit"], ["watch", "runs/damaged"], ["report", "runs/damaged"]):
        assert main(words) in (0, 4), words
    assert RunSource(damaged).figures().state == "not running", "the dashboard shows what its books say"


def test_a_file_that_goes_while_it_is_looked_at_is_no_farm(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    works, ends = run_dir(here, "works"), run_dir(here, "ends")
    for place in (works, ends):
        write_info(place, TCP)
    looked = farm_lookup.is_running

    def ended(place: Path) -> bool:
        running = looked(place)
        if place == ends:
            (ends / FARM_FILE).unlink()
        return running

    monkeypatch.setattr(farm_lookup, "is_running", ended)
    assert farm_lookup.newest_running() == works


def test_only_a_farm_that_this_user_started_may_do_without_insecure(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run folder that others made would have orders, and work of workers, sent in the clear to where it says."""
    place = run_dir(here, "night")
    write_info(place, TCP)
    assert not read_info(place).insecure
    for words in (["control", "status", str(place)], ["worker", "--join", str(place)], ["watch", str(place)]):
        assert main(words) == 2
        assert "--insecure" in capsys.readouterr().err
    farm_register.note(place)
    assert read_info(place).insecure
    farm_register.forget(place)
    with pytest.raises(Refused, match="insecure"):
        farm_lookup.connect(farm_lookup.Where(place))


def test_a_copy_of_a_run_folder_is_not_taken_for_the_farm_of_the_other(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Orders meant for the copy would reach the farm that works in the folder it was copied from."""
    works = run_dir(here, "works")
    write_info(works, TCP)
    copy = Path("runs/copy")
    shutil.copytree(works, copy)
    assert farm_lookup.is_running(works)
    assert not farm_lookup.is_running(copy)
    for words, told in (("control pause", "got none that runs"), ("worker --join", "got a copy of one")):
        assert main([*words.split(), str(copy)]) == 2
        assert told in capsys.readouterr().err
    works.rename("runs/moved")
    assert farm_lookup.is_running(Path("runs/moved"))


@pytest.mark.parametrize("launcher", ["of another boot or namespace 1", ""])
def test_a_number_that_is_somebody_elses_now_is_no_farm(
    launcher: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A farm was killed in a container, or by a power cut; its number is alive here, and another's."""
    dead = run_dir(here, "dead")
    write_info(dead, TCP)
    assert farm_lookup.is_running(dead), "its launcher is alive, its books may be about to begin"
    told = msgspec.json.decode((dead / FARM_FILE).read_bytes(), type=FarmInfo)
    (dead / FARM_FILE).write_bytes(msgspec.json.encode(msgspec.structs.replace(told, launcher=launcher)))
    assert not farm_lookup.is_running(dead)
    assert farm_lookup.newest_at_rest(None) == dead
    assert main(["control", "status", str(dead)]) == 2
    assert "got none that runs" in capsys.readouterr().err
    store = Store.open(dead)  # a farm in a container: its launcher has no number here
    assert farm_lookup.is_running(dead)
    store.close()
    assert not farm_lookup.is_running(dead)


def test_a_launcher_that_has_ended_is_none_whoever_bears_its_number_next(here: Path) -> None:
    dead = run_dir(here, "dead")
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as launcher:
        write_info(dead, msgspec.structs.replace(TCP, pid=launcher.pid))
        assert farm_lookup.is_running(dead)
        text = (dead / FARM_FILE).read_text().replace(f'"pid": {launcher.pid}', f'"pid": {os.getpid()}')
        launcher.communicate(b"\n")
    assert not farm_lookup.is_running(dead)
    (dead / FARM_FILE).write_text(text)
    assert not farm_lookup.is_running(dead)


ORDERS = ("control pause", "control budget 48", "control stop", "scorer use gap", "scorer shadow gap")


def elsewhere(here: Path, name: str) -> Path:
    """A farm of the same user in another folder, begun after all others."""
    away = here.parent / f"{here.name}-other" / "runs" / name
    away.mkdir(parents=True)
    write_info(away, TCP)
    os.utime(away / FARM_FILE, (2**31, 2**31))
    farm_register.note(away)
    return away


@pytest.mark.parametrize("below", ["x", "group/x"])
def test_what_runs_here_goes_before_what_began_later_elsewhere(below: str, here: Path) -> None:
    mine = run_dir(here, below)
    write_info(mine, TCP)
    farm_register.note(mine)
    elsewhere(here, "y")
    assert farm_lookup.newest_running() == farm_lookup.newest(None) == farm_lookup.only_running() == mine


@pytest.mark.parametrize("words", ORDERS)
@pytest.mark.parametrize("names", [("x", "y"), ()])
def test_an_order_that_may_be_meant_for_several_farms_is_given_to_none(
    words: str, names: tuple[str, ...], here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here, or, with none here, elsewhere; what only reads takes the newest and says which."""
    asked: list[Path] = []

    def of_run(place: Path, insecure: bool = False) -> None:
        asked.append(place)
        raise Refused("farm", expected="one that is none of this test's", got="it")

    monkeypatch.setattr(FarmClient, "of_run", of_run)
    for name in names:
        write_info(run_dir(here, name), TCP)
    places = [Path("runs") / name for name in names] or [elsewhere(here, "y"), elsewhere(here, "z")]
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert all(str(place) in said for place in places), said
    assert asked == []
    assert main(["control", "status"]) == 2
    assert "the newest that runs" in capsys.readouterr().err
    assert main([*words.split(), str(places[0])]) == 2
    assert len(asked) == 2
    assert asked[1] == places[0]


@pytest.mark.parametrize(
    ("words", "expected", "got"),
    [
        ("budget", "a whole number of flights", "got none"),
        ("budget runs/night", "a whole number of flights", "got none"),
        ("budget many runs/night", "a whole number of flights of at most 18 digits", "got 'many'"),
        ("budget 1 2 runs/night", "a whole number of flights of at most 18 digits", "got '1 2'"),
        (f"budget {'7' * 200}", "a whole number of flights of at most 18 digits", "777\N{HORIZONTAL ELLIPSIS}'"),
        ("pause 5 runs/night", "one that is there, and nothing else", "got '5'"),
    ],
)
def test_an_order_with_a_number_too_many_or_too_few_says_which(
    words: str, expected: str, got: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir(here, "night")
    assert main(["control", *words.split()]) == 2
    said = capsys.readouterr().err
    assert f"(saflite control {words.split()[0]}): expected {expected}" in said
    assert got in said
    assert "got 0" not in said
