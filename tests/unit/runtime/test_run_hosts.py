"""Who may have a key of a model server as a run goes on: hosts that its own user named, not what a run folder says."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.operations import running
from saflite.contract.config import Campaign, ScorerConfig
from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime import campaign_runner, run_hosts

EVIL, OWN = "https://evil.example:443", "https://there.example:443"


def _campaign(*hosts: str) -> Campaign:
    scorer = ScorerConfig(model="random", shadow=tuple(f"openai:m@{host}/v1" for host in hosts))
    return msgspec.structs.replace(load_campaign("avoidance-m2"), scorer=scorer)


@pytest.fixture(autouse=True)
def own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[str]]:
    """What the farm of a run that goes on lets have a key."""
    hosts: list[Sequence[str]] = []

    def farm(*_: object, key_hosts: Sequence[str], **__: object) -> object:
        hosts.append(key_hosts)
        raise Refused("farm", expected="none here", got="one")

    monkeypatch.setattr(campaign_runner, "LocalFarm", farm)
    return hosts


def _goes_on(run_dir: Path) -> None:
    with pytest.raises(Refused, match="none here"):
        campaign_runner.resume(run_dir, simulators=0)


def test_hosts_that_the_user_named_as_the_run_was_made_have_a_key(
    given: list[Sequence[str]], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    running.create(tmp_path / "run", _campaign(OWN), describe())
    _goes_on(tmp_path / "run")
    assert given == [(OWN,)]
    assert not caplog.records


def test_hosts_that_a_run_of_somebody_else_names_have_none(
    given: list[Sequence[str]], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Whose run was taken up again sent the user's key to whatever server its books named."""
    run_dir, campaign = tmp_path / "received", _campaign(EVIL)
    Store.create(run_dir, campaign, template(campaign), describe()).close()
    forged: list[tuple[str, bytes]] = [
        (run_hosts.FILE, msgspec.json.encode([EVIL])),
        (run_hosts.MARK, b"0" * 64),
        (run_hosts.FILE, b"["),
        (run_hosts.MARK, b""),
    ]
    for name, content in [*forged, ("none", b"")]:
        (run_dir / name).write_bytes(content)
        _goes_on(run_dir)
    assert given == [()] * 5
    assert caplog.records[0].levelno == logging.WARNING
    assert f"no key is sent to {EVIL}" in caplog.messages[0]
    assert f"SAFLITE_KEY_HOSTS={EVIL}" in caplog.messages[0]


@pytest.mark.parametrize("named", [EVIL, EVIL.removeprefix("https://"), f"other:1, {EVIL}"])
def test_of_hosts_that_the_environment_names_it_is_not_told_that_they_have_none(
    named: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SAFLITE_KEY_HOSTS", named)
    assert run_hosts.of(tmp_path, _campaign(EVIL).scorer) == ()
    assert not caplog.records


def test_a_mark_of_one_run_is_good_for_the_hosts_it_was_made_of_alone(
    given: list[Sequence[str]], tmp_path: Path
) -> None:
    running.create(tmp_path / "mine", _campaign(OWN), describe())
    running.create(tmp_path / "theirs", _campaign(EVIL, OWN), describe())
    for name in (run_hosts.FILE, run_hosts.MARK):
        shutil.copy(tmp_path / "mine" / name, tmp_path / "theirs" / name)
    _goes_on(tmp_path / "theirs")
    assert given == [(OWN,)]
