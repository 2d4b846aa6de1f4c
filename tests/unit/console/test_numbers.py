"""Every option that takes a number takes plain ones only, and says so in one line, before anything starts."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import pytest

from saflite.console import cli
from saflite.console.io import arguments
from saflite.contract.errors import Refused

ODD = (
    "nan",
    "-inf",
    "inf",
    "1e400",
    "9" * 400,
    "1_000",
    "\uff11",
    "\u0661",
    "0x10",
    "1,5",
    "",
    " ",
    "1 2",
    "\0",
    "--1",
)
FRACTIONS = ("1.5", "1e3")
NUMBERS = (int, float, arguments.rng_seed, arguments.deadline_s)


def numeric(parser: argparse.ArgumentParser, before: tuple[str, ...] = ()) -> Iterator[tuple[str, bool]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, choice in action.choices.items():
                yield from numeric(choice, (*before, name))
        elif action.option_strings and (action.type in NUMBERS or action.dest == "wall_limit"):
            yield " ".join((*before, action.option_strings[-1])), action.type in (int, arguments.rng_seed)


OPTIONS = [(name, *option) for name in cli.command_names() for option in numeric(cli.parser_of(name))]


def refusal(name: str, option: str, text: str) -> str:
    *before, last = option.split()
    word = f"{last}={text}" if last.startswith("--") else f"{last}{text}"
    with pytest.raises(Refused) as refused:
        cli.parser_of(name).parse_args([*before, word])
    return str(refused.value)


def test_there_are_as_many_as_one_would_think() -> None:
    assert len(OPTIONS) > 35
    assert {name for name, *_ in OPTIONS} >= {
        "run",
        "resume",
        "replay",
        "fly",
        "diff",
        "bisect",
        "sitl",
        "keys",
        "worker",
    }


@pytest.mark.parametrize(("name", "option", "whole"), OPTIONS)
def test_what_is_no_plain_number_is_refused_at_once(name: str, option: str, whole: bool) -> None:
    last = option.split()[-1]
    for text in (*ODD, *(FRACTIONS if whole else ())):
        if text or last.startswith("--"):
            said = refusal(name, option, text)
            assert last in said, (text, said)
            assert "expected" in said, (text, said)
            assert said.isprintable(), (text, said)


@pytest.mark.parametrize(
    ("name", "option", "text"),
    [
        ("fly", "--rng-seed", "-1"),
        ("sitl", "--rng-seed", "-1"),
        ("mutate", "--rng-seed", "-7"),
        ("run", "--rng-seed", "-1"),
        ("score", "--deadline", "0"),
        ("score", "--deadline", "-1"),
        ("evaluate", "bugs --deadline", "0"),
        ("fly", "--wall-limit", "1e9"),
    ],
)
def test_what_is_out_of_its_range_is_refused_at_once(name: str, option: str, text: str) -> None:
    assert option.split()[-1] in refusal(name, option, text)
