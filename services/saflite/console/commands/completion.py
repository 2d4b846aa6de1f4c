"""Print what makes a shell complete commands, options and files: for bash, zsh or fish.

Nothing is needed where it is used. Print it anew after an update.

examples:
  saflite completion bash > ~/.local/share/bash-completion/completions/saflite
  saflite completion zsh > ~/.zfunc/_saflite          (a folder of $fpath, named before compinit)
  saflite completion fish > ~/.config/fish/completions/saflite.fish
"""

from __future__ import annotations

import argparse
import sys

SHELLS = ("bash", "zsh", "fish")


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("shell", choices=SHELLS, help="which shell")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    sys.stdout.write(script(args.shell))
    return 0


def script(shell: str) -> str:
    """Return the script for a shell."""
    import shtab

    from saflite.console.cli import whole_parser

    parser = whole_parser()
    _complete_files(parser, shtab.FILE)
    return str(shtab.complete(parser, shell=shell)) + "\n"


def _complete_files(parser: argparse.ArgumentParser, files: object) -> None:
    """Say of every argument that is a path that files complete it."""
    from pathlib import Path

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _complete_files(command, files)
        elif action.type is Path:
            action.complete = files  # type: ignore[attr-defined]
