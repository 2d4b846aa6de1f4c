"""`saflite keys list` says of each key whether it still counts, and until when the router's certificate does."""

from __future__ import annotations

import argparse
import json
from datetime import datetime
from pathlib import Path

import pytest

from saflite.bus import keyring
from saflite.console.cli import main
from saflite.console.io import farm_options
from saflite.runtime.clock import WallClock

DAY_S = 86_400.0


def test_a_key_is_good_expired_or_revoked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    now_s = WallClock().unix_s()
    keyring.init(tmp_path / "keys", [], now_s=now_s - 3 * DAY_S)
    keyring.add(tmp_path / "keys", "good", ["viewer"], now_s=now_s, days=1)
    keyring.add(tmp_path / "keys", "old", ["viewer"], now_s=now_s - 2 * DAY_S, days=1)
    keyring.add(tmp_path / "keys", "gone", ["viewer"], now_s=now_s, days=1)
    keyring.revoke(tmp_path / "keys", "gone")
    assert main(["keys", "list", "--keys", str(tmp_path / "keys")]) == 0
    said = {line.split()[0]: line.split()[3] for line in capsys.readouterr().out.splitlines()[1:]}
    assert said == {"good": "until", "old": "expired", "gone": "revoked"}


@pytest.mark.parametrize("days_ago", [0, 340, 366])
def test_it_says_until_when_the_router_is_reached_and_how_that_is_mended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], days_ago: int
) -> None:
    keys, now_s = tmp_path / "keys", WallClock().unix_s()
    keyring.init(keys, ["lab.example.org"], now_s=now_s - days_ago * DAY_S)
    listing = ["keys", "list", "--keys", str(keys)]
    assert main(listing) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0].startswith("router, reached by lab.example.org, localhost, 127.0.0.1: ")
    assert ("expired" in out, "authority: until" in out) == (days_ago > 365, True)
    assert ("warning: the router's certificate" in err, "saflite keys renew" in err) == (days_ago > 0, days_ago > 0)
    assert main(["keys", "renew", "--keys", str(keys), "--host", "10.0.0.5"]) == 0
    assert "farms that run" in capsys.readouterr().out
    assert main([*listing, "--json"]) == 0
    out, err = capsys.readouterr()
    said = json.loads(out)
    assert (said["hosts"][-1], err) == ("10.0.0.5", "")
    assert now_s + 364 * DAY_S < datetime.fromisoformat(said["router_expires"]).timestamp() < now_s + 366 * DAY_S
    assert said["authority_expires"] > said["router_expires"]


def test_a_farm_that_starts_says_that_its_router_s_certificate_ends_soon(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "keys"
    keyring.init(keys, [], now_s=WallClock().unix_s(), days=20)
    words = argparse.Namespace(
        listen="tls/127.0.0.1:7447", keys=keys, insecure=False, metrics="", workers=None, on="here", scale=[]
    )
    farm_options.check(words)
    assert "warning: the router's certificate ends at" in capsys.readouterr().err
    keyring.renew(keys, now_s=WallClock().unix_s())
    farm_options.check(words)
    assert capsys.readouterr().err == ""
