"""Every command of the pages is one the command line takes, and needs nothing else or says what."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from page_commands import PAGES, PageCommand, commands
from page_runs import NOT_RUN, PLACES, RUNS, why_not

from saflite.console.cli import parser_of

SHOWN = list(commands())
_INLINE = re.compile(r"`(saflite [a-z]+(?: [^`|\[]*)?)`")
_OPEN = {"COMMAND", "--help"}


def inline() -> Iterator[str]:
    """Yield the commands that sentences of the pages name."""
    for page in PAGES:
        for text in _INLINE.findall(page.read_text(encoding="utf-8")):
            if not _OPEN & set(text.split()):
                yield " ".join(text.split())


def arguments(words: list[str]) -> list[str]:
    return [PLACES.get(word, word) for word in words]


@pytest.mark.parametrize("command", SHOWN, ids=lambda command: f"{command.page}: {command.text}")
def test_a_command_on_a_page_can_be_run_here_or_there_is_a_reason(command: PageCommand) -> None:
    assert (command.text in RUNS) != bool(why_not(command.text)), "name it in page_runs.py"


@pytest.mark.parametrize("command", SHOWN, ids=lambda command: f"{command.page}: {command.text}")
def test_the_command_line_takes_what_pages_show(command: PageCommand) -> None:
    if command.words[0] == "saflite":
        parser_of(command.words[1]).parse_args(arguments(command.words[2:]))


def test_no_command_is_named_that_no_page_shows() -> None:
    shown = {command.text for command in SHOWN}
    assert sorted({*RUNS, *NOT_RUN} - shown) == []


def test_options_named_in_sentences_are_options() -> None:
    found = sorted(set(inline()))
    assert len(found) > 20
    unknown = []
    for text in found:
        _, name, *words = text.split()
        options = parser_of(name).format_help()
        unknown += [
            f"{text}: {word}" for word in words if word.startswith("--") and word.partition("=")[0] not in options
        ]
    assert unknown == []
