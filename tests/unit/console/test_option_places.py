"""Options may stand before, between and after the other words of every command, whatever number of those it takes."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from saflite.console import cli
from saflite.contract.errors import Refused


class Command(NamedTuple):
    """A command or verb of one: the words that lead to it, and its parser."""

    words: tuple[str, ...]
    parser: argparse.ArgumentParser


def leaves(parser: argparse.ArgumentParser, words: tuple[str, ...]) -> Iterator[Command]:
    verbs = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in verbs:
        for name, choice in action.choices.items():
            yield from leaves(choice, (*words, name))
    if not verbs:
        yield Command(words, parser)


COMMANDS = [leaf for name in cli.command_names() for leaf in leaves(cli.parser_of(name), (name,))]


def value(action: argparse.Action, number: int) -> str:
    if action.choices is not None:
        return str(next(iter(action.choices)))
    return "1" if action.type not in (None, Path) else f"word{number}"


def given(action: argparse.Action) -> list[str]:
    """Return an option as it may be given."""
    return [action.option_strings[-1], *([] if action.nargs == 0 else [value(action, 0)])]


def others(parser: argparse.ArgumentParser) -> list[str]:
    """Return words for all that is no option, two where there may be many."""
    count = {"*": 2, "+": 2}
    return [
        value(action, number)
        for action in parser._actions
        if not action.option_strings
        for number in range(count.get(str(action.nargs), 1))
    ]


def needed(parser: argparse.ArgumentParser, option: argparse.Action) -> list[str]:
    """Return the options that go with one, which must be there."""
    found = [action for action in parser._actions if action.option_strings and action.required]
    for group in parser._mutually_exclusive_groups:
        if group.required and option not in group._group_actions:
            found.append(group._group_actions[0])
    return [word for action in found if action is not option for word in given(action)]


def parsed(command: Command, words: list[str]) -> argparse.Namespace:
    return cli.parser_of(command.words[0]).parse_args([*command.words[1:], *words])


def test_there_are_commands_of_each_kind() -> None:
    kinds = {
        str(action.nargs) for command in COMMANDS for action in command.parser._actions if not action.option_strings
    }
    assert kinds == {"None", "?", "*", "+"}
    assert len(COMMANDS) > len(cli.command_names())


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command.words))
def test_an_option_may_stand_anywhere(command: Command) -> None:
    words = others(command.parser)
    for option in command.parser._actions:
        if not option.option_strings or option.dest == "help":
            continue
        first = [*needed(command.parser, option), *given(option)]
        meant = parsed(command, [*first, *words])
        for place in range(1, len(words) + 1):
            assert parsed(command, [*words[:place], *first, *words[place:]]) == meant, (first, place)
            assert parsed(command, [*words[:place], *first, "--", *words[place:]]) == meant, (first, place)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command.words))
def test_help_tells_of_all_words_wherever_it_is_asked_for(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], others(command.parser)):
        with pytest.raises(SystemExit):
            parsed(command, [*words, "--help"])
        assert capsys.readouterr().out == command.parser.format_help()


def test_what_is_missing_or_unknown_is_still_refused() -> None:
    for words, said in (
        (["scorer", "use", "--no-wait"], "model"),
        (["diff", "a", "b"], "--campaign"),
        (["diff", "--campaign", "c", "a"], "BUILD_B"),
        (["export", "run", "--json"], "--format"),
        (["export", "run", "--format", "csv", "--standalone", "x"], "not allowed with"),
        (["score", "a.yaml", "--nope", "b.yaml"], "--nope"),
        (["fly", "a.yaml", "--json", "b.yaml"], "unrecognized arguments: b.yaml"),
    ):
        with pytest.raises(Refused, match=said):
            cli.parser_of(words[0]).parse_args(words[1:])
        cli.parser_of(words[0])


def test_words_after_two_dashes_are_names() -> None:
    args = cli.parser_of("scorer").parse_args(["use", "blend", "--no-wait", "--", "-run"])
    assert (args.model, args.run, args.no_wait) == ("blend", Path("-run"), True)
