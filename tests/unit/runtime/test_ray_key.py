"""The key `ray` of a cluster's workers: made where there is none that counts, once however many farms start."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from saflite.bus import keyring
from saflite.bus.access import STAGE_OF
from saflite.contract.errors import Refused
from saflite.runtime.clock import WallClock
from saflite.runtime.on_ray import KEY_NAME, _key

DAY_S = 86_400.0


def test_farms_that_start_at_once_have_one_key(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keyring.init(keys, [], now_s=WallClock().unix_s())
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: _key(keys, "night"), range(4))) == {keys / "peers" / KEY_NAME}
    given = keyring.peer_credentials(keys / "peers" / KEY_NAME, WallClock().unix_s()).peer
    assert keyring.read_register(keys).peers == (given,)


@pytest.mark.parametrize("end", ["expired", "revoked"])
def test_a_key_that_counts_no_more_is_made_anew_where_that_can_be_done(tmp_path: Path, end: str) -> None:
    keys, now_s = tmp_path / "keys", WallClock().unix_s()
    keyring.init(keys, [], now_s=now_s)
    begins_s = now_s - 2 * DAY_S if end == "expired" else now_s
    keyring.add(keys, KEY_NAME, tuple(STAGE_OF), now_s=begins_s, days=1 if end == "expired" else 30)
    if end == "revoked":
        keyring.revoke(keys, KEY_NAME)
    authority = (keys / "authority.key").rename(tmp_path / "elsewhere")
    with pytest.raises(Refused, match="none that counts"):
        _key(keys, "night")
    authority.rename(keys / "authority.key")
    peer = keyring.peer_credentials(_key(keys, "night"), now_s).peer
    assert peer is not None
    assert keyring.read_register(keys).named(KEY_NAME) == peer
    assert peer.may("night")
