"""Keys that are replaced, on a real router: which certificate of a name counts."""

from __future__ import annotations

import queue
import time
from pathlib import Path

import pytest
from test_keys import CAMPAIGN, _answers, _asked_of, _intended, _open

from saflite.bus import keyring
from saflite.bus.access import Role
from saflite.bus.certificates import Pair, make_certificate
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.zenoh import open_client
from saflite.contract.clock import in_utc
from saflite.runtime.clock import WallClock
from saflite.runtime.serve import KEYS_CHANGED, _on_change

pytestmark = pytest.mark.live


@pytest.mark.parametrize("role", ["operator", "viewer"])
def test_a_revoked_certificate_stays_refused_when_its_name_is_given_another(tmp_path: Path, role: Role) -> None:
    keys, now_s = tmp_path / "keys", time.time()
    keyring.init(keys, [], now_s=now_s)
    stolen = keyring.add(keys, "boss", ["operator"], now_s=now_s).rename(tmp_path / "stolen")
    keyring.revoke(keys, "boss")
    keyring.add(keys, "boss", [role], now_s=now_s)
    asked = _asked_of(CAMPAIGN)
    with PrivateSocket() as private:
        router = _open(keys, private)
        thief = open_client("boss", router.endpoint, patience_s=2.0, keys=keyring.peer_credentials(stolen, time.time()))
        boss = router.client("boss")
        got, meant = _answers(thief, asked), _answers(boss, asked)
        told = (thief.access(), boss.access())
        for bus in (thief, boss, router.bus):
            bus.close()
    assert not [name for name, answer in got.items() if answer is not None]
    assert {name for name, answer in meant.items() if answer is not None} == _intended(role)
    assert {answer for answer in meant.values() if answer is not None} == {b"boss"}
    assert "another key of boss was made after this one" in told[0]
    assert told[1] == f"the key of boss is for {role} in every campaign"


def test_what_was_changed_while_a_router_began_is_noticed(tmp_path: Path) -> None:
    keys, now_s, stops = tmp_path / "keys", time.time(), queue.SimpleQueue[str]()
    keyring.init(keys, [], now_s=now_s)
    keyring.add(keys, "boss", ["operator"], now_s=now_s)
    let_in = (keys / "register.toml").read_bytes()
    keyring.revoke(keys, "boss")
    _on_change(keys / "register.toml", let_in, WallClock(), stops.put)
    assert stops.get(timeout=60.0) == KEYS_CHANGED


def test_a_key_made_before_each_had_a_common_name_of_its_own_counts(tmp_path: Path) -> None:
    keys, now_s = tmp_path / "keys", time.time()
    keyring.init(keys, [], now_s=now_s)
    bundle = keyring.add(keys, "ana", ["viewer"], now_s=now_s)
    authority = Pair((keys / "authority.key").read_bytes(), (keys / "authority.pem").read_bytes())
    old = make_certificate(authority, "ana", in_utc(now_s), 90)
    (bundle / "cert.pem").write_bytes(old.certificate)
    (bundle / "key.pem").write_bytes(old.key)
    for path in (keys / "register.toml", bundle / "peer.toml"):
        kept = [line for line in path.read_text().splitlines() if not line.startswith("common_name")]
        path.write_text("\n".join(kept))
    with PrivateSocket() as private:
        router = _open(keys, private)
        bus = router.client("ana")
        got, told = _answers(bus, _asked_of(CAMPAIGN)), bus.access()
        bus.close()
        router.bus.close()
    assert {name for name, answer in got.items() if answer is not None} == _intended("viewer")
    assert told == "the key of ana is for viewer in every campaign"
