"""What a shell completes: tried in bash itself, the others read by nobody here but their own library."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from saflite.console.cli import command_names, main
from saflite.console.commands.completion import SHELLS, script


def completed(folder: Path, *words: str) -> list[str]:
    """Return what bash offers for the last of the words."""
    (folder / "saflite.bash").write_text(script("bash"))
    listed = " ".join(f"'{word}'" for word in words)
    text = f"""
        source saflite.bash
        COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}
        $(complete -p saflite | sed 's/.*-F \\([^ ]*\\).*/\\1/')
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", text], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_bash_completes_commands_and_options(tmp_path: Path) -> None:
    assert completed(tmp_path, "saflite", "pru") == ["prune"]
    assert completed(tmp_path, "saflite", "prune", "--max") == ["--max-mb"]
    assert "fish" in completed(tmp_path, "saflite", "completion", "")


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_is_known_to_every_shell(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert [name for name in command_names() if name not in text] == []
