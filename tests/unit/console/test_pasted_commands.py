"""Commands that are printed can be pasted into a shell, whatever the run folder is called."""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest

from saflite.bus import keyring
from saflite.campaign.storage.new_folder import new_folder
from saflite.campaign.storage.store import Store
from saflite.console.commands import up
from saflite.console.operations import running
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.conclusion import conclude
from saflite.console.run_data.run_folder import tell_loss
from saflite.contract.errors import Refused
from saflite.contract.plain import argument
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

PACKAGE = Path(__file__).parents[3] / "services" / "saflite"
FOLDER = r"[\w.]*(?:dir|place|folder|keys|listen)"
UNQUOTED = re.compile(r"(?:saflite|program\(\)\}) [a-z]+ (?:[a-z-]+ )*\{" + FOLDER + r"\}")
ODD = ("my runs/night 1", "-night", "it's; a $HOME", "plain/night")


def _refusal(found: pytest.ExceptionInfo[Refused]) -> str:
    return str(found.value)


@pytest.mark.parametrize("name", ODD)
def test_every_command_that_names_a_run_folder_can_be_pasted(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run_dir = Path(name)
    store = Store.create(run_dir, doubles.campaign(10), doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run()
    store.close()
    conclude(run_dir, ExitSummary(False, "signal SIGINT", None, 0), as_json=False)
    conclude(run_dir, ExitSummary(True, "it raised", None, 0, failed=True), as_json=False)
    up._left_alone(run_dir, as_json=False)
    said = [re.sub(r"^(prove it|go on) +", "`", line) + "`" for line in capsys.readouterr().out.splitlines()]
    with pytest.raises(Refused) as found:
        running.check_new(run_dir)
    said.append(_refusal(found))
    with pytest.raises(Refused) as found, new_folder(run_dir):
        pass
    said.append(_refusal(found))
    with pytest.raises(Refused) as found:
        farm_lookup.connect(farm_lookup.Where(run_dir))
    said.append(_refusal(found))
    with pytest.raises(Refused) as found:
        keyring.read_register(run_dir)
    said.append(_refusal(found))
    os.truncate(run_dir / "books.witness", 8)
    tell_loss(run_dir)
    said.append(capsys.readouterr().err)
    commands = [text for line in said for text in re.findall(r"`(saflite (?:\w[^`]*?))(?:   |`)", line)]
    verbs = {shlex.split(command)[1] for command in commands}
    assert verbs >= {"replay", "resume", "audit", "keys"}
    assert len(commands) >= 8
    for command in commands:
        words = shlex.split(command)[2:]
        (named,) = [word for word in words if Path(word) == run_dir or os.path.normpath(word) == name]
        assert not named.startswith("-"), command


def test_no_place_prints_a_folder_in_a_command_as_it_is() -> None:
    shown = "\n".join(path.read_text() for path in PACKAGE.rglob("*.py"))
    assert not UNQUOTED.findall(shown)
    assert UNQUOTED.findall("`saflite resume {run_dir}` goes on, `saflite keys add --keys {args.keys}`")
    assert argument("-a b") == "'./-a b'"
