"""Words of others as they may be shown: nothing in them moves a cursor, colours, hides or reorders text.

Names and messages come from workers, simulators, model servers, logs and files; they are shown on terminals, in pages,
in logs, and in the views of those who read our JSON, SARIF, JUnit and CSV files.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Iterable
from pathlib import Path

TEXT = frozenset("\n\t")  # control characters that are layout
_UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")  # controls, directions of writing and other invisibles, surrogates, line ends
_BEGINS = re.compile("(?:^|(?<=[;|]))(?=\\s*[=+@\uff1d\uff0b\uff20\uff0d-])")
"""Where a program for tables may begin a cell with a formula: those set up for languages with a decimal comma part the
cells at semicolons, those for Chinese, Japanese or Korean take wide signs (U+FF0B and on), too."""


def plain(text: str, keep: frozenset[str] = TEXT) -> str:
    """Return `text` with everything that could steer or hide written as an escape."""
    return text if text.isprintable() else "".join(char if char in keep else _shown(char) for char in text)


def word(text: str) -> str:
    """Return `plain` text on one line: no message can look like several."""
    return plain(text, frozenset())


def argument(path: Path | str) -> str:
    """Return a path as it can be pasted into a shell, as part of a command: quoted where needed, never an option."""
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def in_unicode(path: Path | str) -> str:
    """Return a path as JSON can hold it: bytes of a name that are no UTF-8 as escapes."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def cell(value: object) -> object:
    """Return a value as it may stand in a CSV file: no text there is a formula to whoever opens it as a table."""
    if not isinstance(value, str):
        return value
    return _BEGINS.sub("'", word(value))


def some(names: Iterable[str], most: int = 8, between: str = ", ") -> str:
    """Return names as a list to read, each once, at most so many and how many more there are."""
    each = list(dict.fromkeys(names))
    more = f" and {len(each) - most} more" if len(each) > most else ""
    return between.join(each[:most]) + more


def counted(count: int, what: str) -> str:
    """Return how many there are: `1 find`, `2 finds`."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def cut(text: str, most: int) -> str:
    """Return a text of at most so many characters, with a mark where it goes on."""
    return text if len(text) <= most else f"{text[: most - 1]}\N{HORIZONTAL ELLIPSIS}"


def plain_data(value: object) -> object:
    """Return lists, mappings and texts with each text, and each name in a mapping, made `plain`."""
    match value:
        case str():
            return plain(value)
        case dict():
            return {plain_data(name): plain_data(part) for name, part in value.items()}
        case list() | tuple():
            return [plain_data(part) for part in value]
        case _:
            return value


def plain_json(text: str) -> str:
    """Return JSON with what could steer or hide as escapes of JSON: it says the same, and shows nothing else."""
    if text.isprintable():  # JSON leaves the controls beyond ASCII as they are
        return text
    return "".join(_in_json(char) if char > "~" and _is_unsafe(char) else char for char in text)


def _shown(char: str) -> str:
    if not _is_unsafe(char):
        return char
    code = ord(char)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _in_json(char: str) -> str:
    units = char.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[at]:02x}{units[at + 1]:02x}" for at in range(0, len(units), 2))


def _is_unsafe(char: str) -> bool:
    return unicodedata.category(char) in _UNSAFE
