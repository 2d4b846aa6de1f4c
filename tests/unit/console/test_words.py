"""What the console says: campaign files it writes are read again, progress lines hold what users look for."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from saflite.campaign.presets.campaigns import builtin_campaigns, load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import command_names, main
from saflite.console.commands import control
from saflite.console.io import campaign_options, toml_text
from saflite.console.operations import judging
from saflite.console.operations.replaying import Replayed, line
from saflite.console.view import live, out
from saflite.contract.config import parse_campaign
from saflite.contract.control import Status, WorkerStatus
from saflite.contract.events import Quarantined, ScorerChanged, ViolationFound
from saflite.contract.flight import Delivered, DeliveryAnswer, Flight
from saflite.contract.test_case import Obstacle, Stimulus
from saflite.contract.verdict import NEVER_APPLIED, Judgement, Verdict, Violation
from saflite.simulator_worker.targets import reference

WANTED = "run resume replay fly judge mutate score audit watch list export report doctor scorer evaluate sitl schema"


@pytest.mark.parametrize("name", ["avoidance-m2", "policy-a-chute"])
def test_a_campaign_written_as_toml_is_the_same_campaign(name: str) -> None:
    campaign = campaign_options.changed(
        load_campaign(name), settings=["boxes_min=3"] if "avoid" in name else [], budget=7
    )
    awkward = msgspec.structs.replace(campaign, description='say "x" \\ ü\nnew line', wind=campaign.wind)
    assert parse_campaign(toml_text.dump(awkward), "x") == awkward


def test_all_built_in_campaigns_survive_the_round_trip() -> None:
    for name in builtin_campaigns():
        campaign = load_campaign(name)
        assert parse_campaign(toml_text.dump(campaign), name) == campaign


def status() -> Status:
    worker = WorkerStatus(worker="fly-1", stage="fly", state="busy", leases=1, done=3, busy_share=0.9, silent_s=0.1)
    return Status(
        campaign="x",
        state="running",
        round=3,
        budget=100,
        flights=12,
        reflown=2,
        test_cases=10,
        candidates=80,
        violations_confirmed=2,
        violations_flaky=0,
        violations_pending=1,
        quarantined=1,
        flights_per_s=2.5,
        real_time_factor=310.0,
        since_last_find_s=4.0,
        elapsed_s=20.0,
        scorer="blend",
        scorer_pending="",
        fallbacks=3,
        queues={"fly": 4, "score": 0},
        workers=(worker,),
        seq=9,
    )


def test_a_screen_shows_what_others_call_themselves_as_they_say_it() -> None:
    odd = "[/] [bold]"
    workers = tuple(msgspec.structs.replace(worker, worker=odd, host=f"{odd}{place}", state=odd)
                    for place, worker in enumerate(status().workers * 2))  # fmt: skip
    told = msgspec.structs.replace(status(), campaign=odd, scorer=odd, scorer_pending=odd, workers=workers)
    console = Console(width=200, file=StringIO(), record=True)
    console.print(live._drawn(told))
    shown = console.export_text()
    assert shown.count(odd) == 3 + 3 * len(workers)


def test_a_progress_line_says_what_users_look_for() -> None:
    assert live.one_line(msgspec.structs.replace(status(), trouble="disk full")).endswith("nothing goes on: disk full")
    shown = live.one_line(status())
    words = ("12/100 flights", "2.50/s", "310x real time", "2 finds", "4 s ago", "1/1 busy", "fly 4")
    for word in (*words, "3 scores by the embedded scorer instead"):
        assert word in shown


def test_work_that_nobody_is_there_for_is_told_as_such() -> None:
    told = msgspec.structs.replace(status(), queues={"fly": 4, "score": 12, "judge": 0})
    assert "waiting: fly 4 score 12 (no worker for it)" in live.one_line(told)
    console = Console(width=200, file=StringIO(), record=True)
    console.print(live._drawn(told))
    assert "fly 4, score 12 (no worker for it), judge 0" in console.export_text()


def test_a_status_says_what_each_worker_does(capsys: pytest.CaptureFixture[str]) -> None:
    worker = status().workers[0]
    silent = [msgspec.structs.replace(worker, worker=f"lab-fly-{n}", silent_s=float(n), host="lab") for n in range(50)]
    control._tell_workers(msgspec.structs.replace(status(), workers=tuple(silent)))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["worker", "stage", "state", "done", "busy", "silent", "host"]
    assert lines[1].split() == ["lab-fly-49", "fly", "busy", "3", "90%", "49.0", "s", "lab"]
    assert (len(lines), lines[-1]) == (1 + 40 + 1, "  and 10 more (--json tells of all)")
    control._tell_workers(msgspec.structs.replace(status(), workers=()))
    assert not capsys.readouterr().out


def test_progress_lines_go_on_where_the_books_were_started_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Books that had waited for hours count from where something happened last."""
    campaign = load_campaign("avoidance-m2")
    Store.create(tmp_path / "run", campaign, template(campaign), reference.describe()).close()
    said: list[str] = []
    monkeypatch.setattr(out, "line", said.append)
    view = live._Lines(tmp_path / "run")
    for elapsed_s in (7200.0, 7202.0, 7205.0, 3.0, 4.0, 8.0):
        view.update(msgspec.structs.replace(status(), elapsed_s=elapsed_s, seq=0))
    view.close()
    assert [line.split()[0] for line in said] == ["7200.0", "7205.0", "3.0", "8.0"]


def test_the_live_screen_draws() -> None:
    from rich.console import Console

    console = Console(width=110, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(live._drawn(status()))
    text = console.export_text()
    for word in ("12", "310x", "fly-1", "busy", "4 s ago", "blend", "quarantined"):
        assert word in text


def test_facts_worth_a_line_get_one() -> None:
    violation = Violation(
        fingerprint="f" * 16,
        test_case="c" * 16,
        policy="p",
        robustness=-0.5,
        severity="hard",
        confirmation="confirmed",
        reflown=3,
        failed_again=2,
        rate_low=0.21,
        rate_high=0.94,
    )
    assert live.fact_text(ViolationFound(violation=violation)).startswith("VIOLATION  ffff")
    assert "violates again 2 of 3, rate 0.21 to 0.94" in live.fact_text(ViolationFound(violation=violation))
    assert "not ready" in live.fact_text(ScorerChanged(model="a", previous="b", ready=False))
    assert "3 attempts" in live.fact_text(Quarantined(test_case="c", attempts=3, last="wedged"))


def test_every_command_asked_for_is_there() -> None:
    assert set(WANTED.split()) <= set(command_names())


def test_the_overview_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {name} " in said for name in command_names())


def test_a_real_log_is_judged_with_a_competition_test_case(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "flight"))
    from log_bytes import px4_flight

    from saflite.campaign.presets.campaigns import template
    from saflite.recorder.exports.aerialist import write_case

    log = tmp_path / "log.ulg"
    log.write_bytes(px4_flight())
    bare = template(load_campaign("avoidance-m2"))
    far = Obstacle(length_m=4.0, width_m=4.0, height_m=10.0, x_m=300.0, y_m=300.0)
    boxed = msgspec.structs.replace(bare, scenario=msgspec.structs.replace(bare.scenario, obstacles=(far,)))
    case, *_ = write_case(boxed, tmp_path, "case")
    words = ["judge", str(log), "--test-case", str(case), "--policy", "min-obstacle-distance", "--json"]
    assert main(words) == 0
    assert '"outcome":"held"' in capsys.readouterr().out


def test_verdicts_without_robustness_are_counted_or_told_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    case = template(load_campaign("avoidance-m2"))
    verdicts = (
        Verdict(policy="never", outcome="vacuous", nearness=0.5, message=NEVER_APPLIED),
        Verdict(policy="blind", outcome="inconclusive", nearness=0.0, message="the trace holds no mode"),
        Verdict(policy="kept", outcome="held", robustness=2.0),
        Verdict(policy="broken", outcome="violated", robustness=-1.0, message="by far"),
    )
    judgement = Judgement(test_case="x", flight_index=0, verdicts=verdicts)
    judging.show(case, Flight(test_case="x", flight_index=0, ending="completed"), judgement)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()][1:]
    assert [line[:3] for line in lines[:2]] == [["VIOLATED", "broken", "-1"], ["held", "kept", "+2"]]
    told = [" ".join(line) for line in lines[2:]]
    assert told == ["1 policy vacuous: the rule never applied", "1 policy inconclusive: the rule could not be judged"]
    judging.show(case, Flight(test_case="x", flight_index=0, ending="completed"), judgement, everything=True)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()][3:]
    assert [" ".join(line) for line in lines] == [
        "vacuous never the rule never applied",
        "inconclusive blind the trace holds no mode",
    ]


@pytest.mark.parametrize(
    ("robustness", "violated", "vacuous", "words"),
    [
        (-0.5, ("p",), (), "violates p, robustness -0.500"),
        (0.5, (), ("q",), "holds, robustness +0.500"),
        (None, (), ("p", "q"), "vacuous: the rule never applied"),
        (None, (), (), "inconclusive: nothing could be judged"),
    ],
)
def test_a_replay_says_what_the_policies_said(
    robustness: float | None, violated: tuple[str, ...], vacuous: tuple[str, ...], words: str
) -> None:
    result = Replayed(
        name="x",
        test_case="c",
        ending="completed",
        simulated_s=1.0,
        wall_s=0.1,
        recorded_digest="d",
        trace_digest="d",
        repeats="bitwise",
        bit_equal=True,
        violated=violated,
        vacuous=vacuous,
        robustness=robustness,
    )
    assert line(result) == f"x  completed  {words}  trace d bit-equal"


def test_inputs_that_were_not_taken_are_told_with_why(capsys: pytest.CaptureFixture[str]) -> None:
    answers: tuple[DeliveryAnswer, ...] = ("accepted", "timed_out", "late", *(("denied",) * 8))
    stimuli = tuple(Stimulus(at_s=float(n), kind="mode", name=f"M{n}") for n in range(len(answers) + 1))
    case = msgspec.structs.replace(template(load_campaign("avoidance-m2")), stimuli=stimuli)
    delivered = tuple(
        Delivered(index=n, at_s=float(n), answer=answer, message="why not" if answer == "denied" else "")
        for n, answer in enumerate(answers)
    )
    flight = Flight(test_case="x", flight_index=0, ending="completed", delivered=delivered)
    judging.show(case, flight, Judgement(test_case="x", flight_index=0, verdicts=()))
    (said,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("inputs"))
    assert (
        "12, of which 1 timed out, 1 late, 8 denied, 1 not given: 1 s mode M1 (timed out); 2 s mode M2 (late)" in said
    )
    assert "3 s mode M3 (denied: why not)" in said
    assert said.endswith(" and 6 more")
    taken = msgspec.structs.replace(flight, delivered=delivered[:1])
    judging.show(
        msgspec.structs.replace(case, stimuli=stimuli[:1]), taken, Judgement(test_case="x", flight_index=0, verdicts=())
    )
    assert "inputs" not in capsys.readouterr().out
