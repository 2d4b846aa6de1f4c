"""Labels of scorer models: a kind, and after a colon what the kind needs to know."""

from __future__ import annotations

from saflite.contract.errors import Refused

BRIEF = "+brief"
"""Stands after the name of a language model that is to give scores alone."""


def split_label(label: str) -> tuple[str, str]:
    """Return kind and argument of a label: `ollama:mistral:7b` is (`ollama`, `mistral:7b`)."""
    kind, _, argument = label.partition(":")
    return kind, argument


def split_brief(name: str) -> tuple[str, bool]:
    """Return the name of a language model as its server knows it, and whether scores are asked for without words."""
    return name.removesuffix(BRIEF), name.endswith(BRIEF)


def check_no_password(url: str) -> None:
    """Raise Refused, without saying it, for an address with a name or password: labels and addresses are told.

    They stand in events, reports and exports, and in what a server's refusal is told with.
    """
    if "@" in url:
        fix = "keys stand in OPENAI_API_KEY or OLLAMA_API_KEY"
        raise Refused("scorer model", expected="an address without a name or password", got="one with such", fix=fix)


def no_argument(kind: str, argument: str) -> None:
    """Raise Refused if a model that takes no argument was given one."""
    if argument:
        raise Refused("scorer model", expected=f"{kind!r} alone", got=f"'{kind}:{argument}'")
