"""Labels of logs in the layouts there are, extracts of logs, and what is missing: told and counted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from saflite.console import cli
from saflite.console.evaluation import logs as logs_module
from saflite.console.evaluation.evaluating import read_cases
from saflite.console.evaluation.labels import Labels, read_labels
from saflite.console.evaluation.logs import RULE, evaluate_logs
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.signals import MODES
from saflite.flight.logs.files import read_trace
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.llm.chat import ChatResult, Question
from saflite.scorer_pool.llm.scorer import LanguageModel

HEADS = "t_s,x,y,z,vz,rollspeed,nav_state,arming_state,fix_type,landed"
FLIGHT = [
    f"{0.5 * n:g},{n},{2 * n},{-3 * n},-6,{0.1 * n},{3 if n < 5 else 5},{2 if n else 1},{3 if n < 7 else 0},0"
    for n in range(10)
]


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def an_extract(path: Path) -> Path:
    return write(path, HEADS, *FLIGHT)


# ---- extracts -----------------------------------------------------------------------------------------------------


def test_an_extract_is_read_with_signs_units_and_modes(tmp_path: Path) -> None:
    write(tmp_path / "summary.csv", "file,messages_warn_or_worse", "log,[a] Failsafe on | [b] odd")
    trace = read_trace(an_extract(tmp_path / "log.csv"))
    last = {name: float(trace.array(name)[-1]) for name in trace.signals}
    assert last["altitude_m"] == pytest.approx(27.0), "PX4 counts downwards"
    assert last["climb_mps"] == pytest.approx(6.0)
    assert last["roll_rate_dps"] == pytest.approx(np.degrees(0.9), rel=1e-5)
    assert last["mode"] == MODES["RTL"]
    assert float(trace.array("mode")[0]) == MODES["AUTO"]
    assert (last["armed"], float(trace.array("armed")[0])) == (1.0, 0.0)
    assert last["gps_ok"] == 0.0
    assert [message.text for message in trace.messages] == ["[a] Failsafe on", "[b] odd"]


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        ((HEADS, "0,1,2"), "line 2"),
        ((HEADS, FLIGHT[0], FLIGHT[1].replace("-6", "down")), "line 3"),
        (("time,x,y,z", "0,1,2,3"), "t_s"),
        (("t_s,nav_state", "0,3", "1,3"), "position"),
        ((HEADS,), "position"),
    ],
)
def test_a_damaged_extract_is_refused_with_its_place(tmp_path: Path, lines: tuple[str, ...], named: str) -> None:
    with pytest.raises(Refused, match=named):
        read_trace(write(tmp_path / "log.csv", *lines))


# ---- labels -------------------------------------------------------------------------------------------------------


def test_labels_of_both_layouts_mean_the_same(tmp_path: Path) -> None:
    plain = read_labels(write(tmp_path / "a.csv", "log,interesting", "one,yes", "two,no", "three,unclear"))
    issues = read_labels(write(tmp_path / "b.csv", "pr,log_id,shows_issue", "1,one,yes", "1,two,no", "2,three,unclear"))
    assert plain == issues == Labels({"one": True, "two": False, "three": None})


@pytest.mark.parametrize(
    ("lines", "named"),
    [
        (("name,label", "one,yes"), "log_id, shows_issue"),
        (("log,interesting",), "no rows"),
        (("log,interesting", "one,perhaps"), "line 2"),
        (("log,interesting", "one,yes", "one,no"), "line 3"),
        (("log,interesting", ",yes"), "line 2"),
    ],
)
def test_another_layout_or_answer_is_refused_with_its_place(tmp_path: Path, lines: tuple[str, ...], named: str) -> None:
    with pytest.raises(Refused, match=named):
        read_labels(write(tmp_path / "labels.csv", *lines))


@pytest.mark.parametrize(
    ("file", "label"),
    [
        ("log_1.ulg", "log_1"),
        ("log_1_before.ulg", "log_1"),
        ("77__after__0f4f-c7.csv", "0f4f-c7"),
        ("log_12.ulg", "log_12"),
        ("x0f4f-c7y.ulg", ""),
        ("x0f4f-c7y_0f4f-c7.ulg", "0f4f-c7"),
        ("other.ulg", ""),
    ],
)
def test_a_log_has_the_longest_label_that_fits(file: str, label: str) -> None:
    names = ("log_1", "log_12", "0f4f-c7", "")
    assert Labels(dict.fromkeys(names, True)).name_for(Path(file)) == label


@pytest.mark.parametrize("file", ["flight10.ulg", "flight12_after.ulg", "flight1a.bin", "77_flight1x.csv"])
def test_a_label_is_not_that_of_a_log_whose_name_goes_on(file: str) -> None:
    """A log nobody labelled must stay without a label: it would be counted with another's answer."""
    labels = Labels({"flight1": True, "flight2": False})
    assert labels.name_for(Path(file)) == ""
    assert labels.without_log([Path(file)]) == ("flight1", "flight2")
    assert labels.name_for(Path("flight1_after.ulg")) == labels.name_for(Path("flight1.bin")) == "flight1"


# ---- what is missing ----------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a log, one without a position, one that is damaged, and a table that is no log."""
    logs = tmp_path / "logs"
    logs.mkdir()
    an_extract(logs / "good.csv")
    write(logs / "nowhere.csv", "t_s,nav_state,roll_deg", "0,3,1", "0.5,3,2", "1,5,3")
    write(logs / "bad.csv", HEADS, "0,1,2")
    write(logs / "notes.csv", "who,what", "me,this")
    return logs


def test_what_cannot_be_counted_is_named(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labels = Labels({"good": True, "nowhere": False, "gone": True, "bad": False})
    cases, missing = read_cases(folder, labels)
    assert {case.name: case.interesting for case in cases} == {"good.csv": True, "nowhere.csv": False}
    assert missing.without_log == ("gone",)
    assert missing.unreadable == ("bad.csv",)
    assert missing.without_position == ("nowhere.csv",)
    assert "bad.csv line 2" in capsys.readouterr().err


class NoServer:
    """A server that cannot be reached."""

    async def ask(self, question: Question) -> ChatResult:
        raise Unavailable("nobody answers")

    async def load(self) -> str:
        raise Unavailable("nobody answers")

    async def digest(self) -> str:
        raise Unavailable("nobody answers")


def test_a_model_that_is_not_there_is_told_and_counted_as_missing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    labels = write(tmp_path / "labels.csv", "log,interesting", "good,yes", "nowhere,no", "gone,no")
    monkeypatch.setattr(logs_module, "make", lambda label, tools: LanguageModel(label, NoServer(), tools.clock, 5.0))
    code = cli.main(["evaluate", "logs", str(folder), "--labels", str(labels), "--model", "ollama:none", "--json"])
    told = capsys.readouterr()
    report = json.loads(told.out)
    assert code == 3
    assert "ollama:none answered nothing" in told.err
    assert report["unanswered"] == {"ollama:none": 2, "random": 0, RULE: 0}
    assert [one["flights"] for one in report["calibrations"]] == [0, 2, 2], "figures of the others stand"
    assert report["missing"] == [["gone"], ["bad.csv"], ["nowhere.csv"]]


def test_the_constants_stand_beside(folder: Path) -> None:
    cases, _ = read_cases(folder, Labels({"good": True, "nowhere": False}))
    one = evaluate_logs(cases, RULE, WallClock()).calibrations[0]
    assert one.always.f1.value == pytest.approx(2 / 3)
    assert one.never.accuracy.value == 0.5


# ---- logs of one name ---------------------------------------------------------------------------------------------


@pytest.fixture
def alike(tmp_path: Path) -> Path:
    """Return a folder with two logs called alike, and two that differ in their suffix only."""
    for place in ("a/flight.csv", "b/flight.csv", "b/flight.mcap.csv", "one.csv"):
        (tmp_path / "logs" / place).parent.mkdir(parents=True, exist_ok=True)
        an_extract(tmp_path / "logs" / place)
    (tmp_path / "logs" / "one.ulog").write_bytes(b"no log")
    return tmp_path / "logs"


def test_logs_called_alike_are_told_apart(alike: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["evaluate", "logs", str(alike), "--text", str(tmp_path / "txt"), "--json"]) == 0
    names = {answer["log"] for answer in json.loads(capsys.readouterr().out)["answers"]}
    assert names == {"a/flight.csv", "b/flight.csv", "b/flight.mcap.csv", "one.csv"}
    written = {path.relative_to(tmp_path / "txt").as_posix() for path in (tmp_path / "txt").rglob("*.txt")}
    assert written == {"a/flight.txt", "b/flight.txt", "b/flight.mcap.txt", "one.csv.txt"}
    cli.main(["judge", str(alike)])
    table = capsys.readouterr().out
    assert all(name in table for name in names)


def test_logs_called_alike_are_labelled_by_their_paths(alike: Path) -> None:
    cases, missing = read_cases(alike, Labels({"a/flight": True, "b/flight.csv": False, "c/flight": True}))
    told = {case.name: case.interesting for case in cases}
    assert (told["a/flight.csv"], told["b/flight.csv"], told["one.csv"]) == (True, False, None)
    assert missing.without_log == ("c/flight",)


def test_a_label_that_means_two_logs_called_alike_is_refused(alike: Path) -> None:
    with pytest.raises(Refused, match=r"a/flight.csv, b/flight.csv.*'flight' for both"):
        read_cases(alike, Labels({"flight": True}))


def test_labels_with_a_byte_order_mark_are_read(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_bytes(b"\xef\xbb\xbflog,interesting\none,yes\n")
    assert read_labels(path) == Labels({"one": True})


def test_a_label_without_a_name_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"line 2.*expected the name of a log, got none"):
        read_labels(write(tmp_path / "labels.csv", "log,interesting", ",yes"))
