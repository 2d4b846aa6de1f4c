"""`saflite keys list` says of each key whether it still counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from saflite.bus import keyring
from saflite.console.cli import main
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
