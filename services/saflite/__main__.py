"""`python -m saflite` is the `saflite` command."""

from __future__ import annotations

from saflite.console.cli import command

if __name__ == "__main__":
    command()
