"""Keys that others can change are nobody's: who can replace the authority decides whom this end trusts."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from saflite.bus import keyring
from saflite.contract.errors import Refused

NOW_S = 1_800_000_000.0
STRANGER = 12345
FARM = ("", "register.toml", "farm", "farm/ca.pem", "farm/cert.pem", "farm/key.pem")
PEER = ("", "peer.toml", "ca.pem", "cert.pem", "key.pem")


def _farm(keys: Path) -> object:
    return keyring.farm_credentials(keys, NOW_S)


def _peer(keys: Path) -> object:
    return keyring.peer_credentials(keys / "peers" / "lab2", NOW_S)


def _add(keys: Path) -> object:
    return keyring.add(keys, "lab3", ["viewer"], now_s=NOW_S)


def _renew(keys: Path) -> object:
    return keyring.renew(keys, now_s=NOW_S)


def _revoke(keys: Path) -> None:
    keyring.revoke(keys, "lab2")


def _init(keys: Path) -> object:
    return keyring.init(keys, [], now_s=NOW_S, if_needed=True)


READ = [
    *((_farm, name) for name in FARM),
    *((_peer, f"peers/lab2/{name}".rstrip("/")) for name in PEER),
    *((_add, name) for name in ("", "register.toml", "authority.pem", "authority.key")),
    *((_renew, name) for name in ("", "register.toml", "authority.pem", "authority.key")),
    *((read, name) for read in (_revoke, _init, keyring.read_register) for name in ("", "register.toml")),
    *((keyring.ends, name) for name in ("farm", "farm/ca.pem", "farm/cert.pem")),
]
read_at = pytest.mark.parametrize(("read", "name"), READ, ids=lambda part: part if isinstance(part, str) else "")


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    keyring.init(tmp_path / "keys", [], now_s=NOW_S)
    keyring.add(tmp_path / "keys", "lab2", ["worker"], now_s=NOW_S)
    return tmp_path / "keys"


def _kept(keys: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in keys.rglob("*") if path.is_file()}


@read_at
def test_keys_that_anybody_can_change_are_refused(read: Callable[[Path], object], name: str, keys: Path) -> None:
    before = _kept(keys)
    (keys / name).chmod((keys / name).stat().st_mode | 0o002)
    with pytest.raises(Refused, match=r"anybody can write|mode 0600") as fault:
        read(keys)
    assert str(keys / name) in str(fault.value)
    assert "chmod" in fault.value.fix
    assert _kept(keys) == before
    (keys / name).chmod((keys / name).stat().st_mode & ~0o002)
    read(keys)


@read_at
@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_keys_of_another_user_are_refused_by_root_too(read: Callable[[Path], object], name: str, keys: Path) -> None:
    os.chown(keys / name, STRANGER, -1)
    with pytest.raises(Refused, match=f"one of user {STRANGER}"):
        read(keys)


@read_at
def test_keys_that_a_group_can_change_are_refused(read: Callable[[Path], object], name: str, keys: Path) -> None:
    group = next((one for one in os.getgroups() if one != os.getegid()), STRANGER if os.geteuid() == 0 else None)
    if group is None:
        pytest.skip("this user is in no second group")
    os.chown(keys / name, -1, group)
    (keys / name).chmod((keys / name).stat().st_mode | 0o020)
    with pytest.raises(Refused, match=r"others of its group can write|mode 0600"):
        read(keys)


def test_keys_behind_links_count_where_they_lie(keys: Path, tmp_path: Path) -> None:
    """As a Secret is mounted: a link to a folder of the day."""
    bundle, day = tmp_path / "given", tmp_path / "day"
    shutil.copytree(keys / "peers" / "lab2", day)
    bundle.mkdir(mode=0o700)
    for path in day.iterdir():
        (bundle / path.name).symlink_to(path)
    assert keyring.peer_credentials(bundle, NOW_S).peer
    day.chmod(0o777)
    with pytest.raises(Refused, match="anybody can write"):
        keyring.peer_credentials(bundle, NOW_S)


def test_no_link_on_the_way_to_a_key_lies_where_others_can_put_another(keys: Path, tmp_path: Path) -> None:
    """What is read may be root's own, such as the authority of somebody else: it is the link that says which."""
    bundle, between = keys / "peers" / "lab2", tmp_path / "between"
    between.mkdir()
    (keys / "farm" / "ca.pem").rename(tmp_path / "ca.pem")
    (between / "ca.pem").symlink_to("../ca.pem")
    (bundle / "ca.pem").unlink()
    (bundle / "ca.pem").symlink_to(between / "ca.pem")
    assert keyring.peer_credentials(bundle, NOW_S).peer
    between.chmod(0o777)
    with pytest.raises(Refused, match="anybody can write") as fault:
        keyring.peer_credentials(bundle, NOW_S)
    assert str(between) in str(fault.value)


def test_no_keys_are_made_where_others_can_write(tmp_path: Path) -> None:
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys").chmod(0o777)
    with pytest.raises(Refused, match="anybody can write"):
        keyring.init(tmp_path / "keys", [], now_s=NOW_S)
    assert not list((tmp_path / "keys").iterdir())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("name", ["peers", "peers/lab2"])
def test_root_puts_no_key_in_a_folder_of_another_user(name: str, keys: Path) -> None:
    keyring.revoke(keys, "lab2")
    os.chown(keys / name, STRANGER, STRANGER)
    before = _kept(keys)
    with pytest.raises(Refused, match=f"one of user {STRANGER}"):
        keyring.add(keys, "lab2", ["worker"], now_s=NOW_S)
    assert _kept(keys) == before
