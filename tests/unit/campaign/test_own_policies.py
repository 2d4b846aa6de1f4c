"""A policy of one's own: named in a campaign file, or run as it is; its text travels with the campaign."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.io import campaign_options
from saflite.console.io.toml_text import dump
from saflite.contract.config import Campaign, parse_campaign
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.join import Join
from saflite.contract.service import Service
from saflite.contract.test_case import StartState, identity
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Ask, Failure, JudgeWork, Report, Stage
from saflite.evidence.memory import MemoryBlobs
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator import work as mutator
from saflite.oracle import work as oracle
from saflite.oracle.policy import load_policy
from saflite.recorder import recording
from saflite.recorder import work as recorder
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import brief_of
from saflite.scorer_pool import work as scorer_pool
from saflite.simulator_worker import work as simulator

POLICY = """id = "stay-low"
title = "Stay below the ceiling"
source = "our own flight manual"
interestingness = "The vehicle must stay below the ceiling. Interesting are climbs."
formula = "always (time_s >= 1 implies altitude_m <= ceiling_m)"

[constants]
ceiling_m = 5.0

[signals]
altitude_m = "m"
time_s = "s"

[start]
mode = "ALT_HOLD"
altitude_m = 30.0

[preconditions]
PILOT_SPEED_UP = 300

[inputs]
sticks = ["RC3"]
parameters = ["PILOT_SPEED_UP"]

[[examples]]
holds = true
why = "low"
duration_s = 5.0
signals = { altitude_m = 4 }

[[examples]]
holds = false
why = "high"
duration_s = 5.0
signals = { altitude_m = [[0, 4], [3, 6]] }
"""
CAMPAIGN = """name = "mine"
policies = ["rules/low.toml", "upright"]
budget_flights = 2
time_limit_s = 12.0
record = "none"
[start]
mode = "ALT_HOLD"
altitude_m = 30.0
[strategy]
name = "pgfuzz"
[scorer]
model = "relevance"
[search]
candidates_per_round = 1
flights_per_round = 1
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rules").mkdir()
    (tmp_path / "rules" / "low.toml").write_text(POLICY)
    (tmp_path / "mine.toml").write_text(CAMPAIGN)
    return tmp_path


def test_a_policy_file_is_looked_for_beside_the_campaign_and_kept_in_it(folder: Path) -> None:
    campaign = load_campaign(str(folder / "mine.toml"))
    assert campaign.policies == ("stay-low", "upright")
    campaign_options.check_runnable(campaign)
    (folder / "rules" / "low.toml").unlink()
    assert load_policy("stay-low", campaign.policy_texts).file.title == "Stay below the ceiling"
    assert brief_of("stay-low", campaign.policy_texts).interestingness.startswith("The vehicle must stay")
    assert parse_campaign(dump(campaign), "again") == campaign


def test_a_campaign_with_a_policy_of_its_own_is_judged_by_it_to_a_confirmed_violation(folder: Path) -> None:
    campaign = msgspec.structs.replace(load_campaign(str(folder / "mine.toml")), record="violations")
    store = Store.create(folder / "run", campaign, template(campaign), describe())
    books = store.rebuild()
    services: dict[Stage, Service] = {
        "mutate": mutator.open_service(),
        "score": scorer_pool.open_service(brief_of, WallClock()),
        "fly": simulator.open_service("inline", WallClock(), store.blobs),
        "judge": oracle.open_service(store.blobs),
        "record": recorder.open_service(store.blobs, WallClock()),
    }
    books.begin(0.0, 0.0)
    for turn in range(40):
        for stage, service in services.items():
            worker = f"{stage}-{turn % 2}"
            assert not books.join(Join(protocol=PROTOCOL, worker=worker, stage=stage), float(turn))
            for lease in books.ask(Ask(worker=worker, stage=stage, cursor=service.cursor), float(turn)).leases:
                result = service.do(lease.work, lambda: False)
                assert not isinstance(result, Failure), result
                told = Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
                assert books.report(told, float(turn)).status == "accepted"
            store.commit(books.drain())
    status = books.status(40.0)
    store.close()
    for service in services.values():
        service.close()
    assert (status.violations_confirmed, status.quarantined) == (2, 0)
    files = [*(folder / "run" / "recordings").iterdir()]
    assert files
    assert [recording.read(file).policy_texts["stay-low"].text for file in files] == [POLICY] * len(files)


def test_a_policy_file_stands_for_the_campaign_over_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    campaign = load_campaign(os.path.join("rules", "low.toml"))
    assert (campaign.name, campaign.policies) == ("policy-stay-low", ("stay-low",))
    assert campaign.start == StartState(mode="ALT_HOLD", altitude_m=30.0)
    assert campaign.target.parameters == {"PILOT_SPEED_UP": 300.0}
    assert campaign.strategy.settings["hints"] == ["stay-low start:ALT_HOLD@30 parameter:PILOT_SPEED_UP stick:RC3"]
    assert campaign.search.shrink
    campaign_options.check_runnable(campaign)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('id = "stay-low"', 'id = "../x y"', r"id \(.*low.toml line 1\): expected small letters"),
        ('id = "stay-low"', 'id = "upright"', r"id \(.*low.toml line 1\): expected one that no shipped policy has"),
        ('id = "stay-low"\n', "", "expected an id"),
        ('mode = "ALT_HOLD"', 'mode = "LOITERR"', r"start mode: expected one of .*'LOITERR'"),
        ('"RC3"', '"RC99"', r"\[inputs\] sticks \(.*low.toml line .*RC1.*'RC99'"),
        ('parameters = ["PILOT_SPEED_UP"]', 'parameters = ["PILOT_SPEEDUP"]', "PILOT_SPEEDUP"),
        ("PILOT_SPEED_UP = 300", "FOO_BAR = 300", "FOO_BAR"),
        ("PILOT_SPEED_UP = 300", 'PILOT_SPEED_UP = "fast"', r"low.toml line .*a number is expected"),
        ("altitude_m = 30.0", 'altitude_m = "high"', r"low.toml line .*a number is expected"),
        ("ceiling_m)", "ceiling_m / 0)", "a divisor other than 0"),
        ("[inputs]", "[[inputs]]", r"low.toml line .*a table is expected"),
    ],
)
def test_a_wrong_policy_file_is_refused_where_it_is_wrong(folder: Path, old: str, new: str, reason: str) -> None:
    assert old in POLICY
    (folder / "rules" / "low.toml").write_text(POLICY.replace(old, new))
    with pytest.raises(Refused, match=reason):
        campaign_options.check_runnable(load_campaign(str(folder / "rules" / "low.toml")))


def test_a_policy_its_target_cannot_show_is_refused_with_the_reason() -> None:
    with pytest.raises(Refused, match="no such mode"):
        load_campaign("policy-a-drift1")
    campaign = msgspec.structs.replace(load_campaign("policy-a-chute"), policies=("a-drift1",))
    with pytest.raises(Refused, match=r"policy a-drift1.*no such mode"):
        campaign_options.check_runnable(campaign)


@pytest.mark.parametrize("table", ["start", "wind", "target"])
def test_unknown_keys_are_refused_in_every_table(table: str) -> None:
    with pytest.raises(Refused, match=rf"\[{table}\].*expected one of .*'foo'"):
        parse_campaign(f'name = "x"\n[{table}]\nfoo = 1', "x.toml")


def test_a_defect_the_campaign_cannot_see_is_remarked_on() -> None:
    campaign: Campaign = campaign_options.changed(load_campaign("policy-a-chute"), defects=["land-fast"])
    assert campaign_options.remarks(campaign) == [
        "note: defects land-fast breaks a-land2, which this campaign does not check"
    ]
    assert not campaign_options.remarks(
        campaign_options.changed(load_campaign("policy-a-land2"), defects=["land-fast"])
    )


@pytest.mark.parametrize("signals", ['signals = "("', '[signals]\n"a(" = "m"\n'])
def test_names_of_signals_that_no_file_can_have_are_refused(signals: str, tmp_path: Path) -> None:
    odd = tmp_path / "odd.toml"
    odd.write_text(
        POLICY.replace('[signals]\naltitude_m = "m"\ntime_s = "s"\n', "").replace(
            "[constants]", f"{signals}\n[constants]"
        )
    )
    load_campaign(str(odd))
    with pytest.raises(Refused):
        load_policy(str(odd))


def test_who_sends_work_names_no_files_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A farm may be a stranger's: what stood in a file beside its worker, its complaint about it told."""
    (tmp_path / "secret.toml").write_text('password = "x"\n')
    monkeypatch.chdir(tmp_path)
    base = template(load_campaign("policy-a-chute"))
    flight = Flight(test_case=identity(base), flight_index=0, ending="wedged")
    for name in ("secret.toml", "none.toml"):
        said = f"policy: expected the text of one that does not ship, got the name of a file, '{name}'"
        for ask in (
            lambda name=name: brief_of(name, {}),
            lambda name=name: oracle.open_service(MemoryBlobs()).do(
                JudgeWork(test_case=base, flight=flight, policies=(name,)), lambda: False
            ),
        ):
            with pytest.raises(Refused) as told:
                ask()
            assert str(told.value) == said
