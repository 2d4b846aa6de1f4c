"""A campaign on a target of one's own, from the search to the repeated find, in this process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.operations import replaying
from saflite.console.run_data.run_folder import open_run
from saflite.contract import modules
from saflite.contract.join import Join
from saflite.contract.service import Service
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Ask, Failure, Report, Stage
from saflite.mutator import work as mutator
from saflite.oracle import work as oracle
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import brief_of
from saflite.scorer_pool import work as scorer_pool
from saflite.simulator_worker import work as simulator
from saflite.simulator_worker.registry import describe_target

FOLDER = Path(__file__).parents[3] / "deploy" / "examples" / "targets"
TURNS = 2000
WALL_LIMIT_S = 60.0


def run(name: str, run_dir: Path) -> None:
    """Run the example campaign over a few flights to its end."""
    whole = load_campaign(str(FOLDER / f"{name}.toml"))
    search = msgspec.structs.replace(whole.search, shrink_flights_max=150)
    campaign = msgspec.structs.replace(whole, budget_flights=24, record="none", search=search)
    info = describe_target(campaign.target.name)
    store = Store.create(run_dir, campaign, template(campaign, info.build), info)
    books = store.rebuild()
    services: dict[Stage, Service] = {
        "mutate": mutator.open_service(),
        "score": scorer_pool.open_service(brief_of, WallClock()),
        "fly": simulator.open_service("inline", WallClock(), store.blobs, verify=True),
        "judge": oracle.open_service(store.blobs),
    }
    books.begin(0.0, 0.0)
    try:
        for turn in range(TURNS):
            for stage, service in services.items():
                worker = f"{stage}-{turn % 2}"
                assert not books.join(Join(protocol=PROTOCOL, worker=worker, stage=stage), float(turn))
                for lease in books.ask(Ask(worker=worker, stage=stage, cursor=service.cursor), float(turn)).leases:
                    result = service.do(lease.work, lambda: False)
                    assert not isinstance(result, Failure), result
                    told = Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
                    assert books.report(told, float(turn)).status == "accepted"
                store.commit(books.drain())
            if books.ended:
                break
        assert books.ended, "the campaign did not come to its end"
    finally:
        store.close()
        for service in services.values():
            service.close()


@pytest.fixture(autouse=True)
def examples() -> Iterator[None]:
    """Let this process find the example targets."""
    modules.use(FOLDER.glob("*.py"))
    yield
    modules.forget()


@pytest.mark.parametrize(("name", "bitwise"), [("point-mass", True), ("drifting-mass", False)])
def test_a_campaign_finds_confirms_makes_small_and_replays(name: str, bitwise: bool, tmp_path: Path) -> None:
    run(name, tmp_path)
    with open_run(tmp_path) as found:
        violations = found.violations("confirmed")
        small = [one for one in violations if found.test_case(one.test_case).origin.note.startswith("shrunk")]
        inputs = {len(found.test_case(one.test_case).stimuli) for one in small}
    assert audit(tmp_path)["problems"] == []
    assert violations
    assert small
    assert min(inputs) == 3 if bitwise else min(inputs) <= 3  # AIM, GAIN and WEAK; LEAN, by chance with others
    entries = replaying.entries(tmp_path, small[0].test_case, everything=False, policies=())
    flown = list(replaying.replay(entries, None, WALL_LIMIT_S))
    assert len(flown) == (1 if bitwise else 5)
    assert [again.bit_equal for again in flown] == [bitwise] * len(flown)
    assert not any(replaying.differs(again) for again in flown)
    assert any(again.violated for again in flown)
    assert ("bit-equal" in replaying.conclusion(flown)) == bitwise
