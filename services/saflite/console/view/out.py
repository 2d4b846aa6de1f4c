"""The only place that writes to the terminal: lines, tables, JSON for scripts, complaints on stderr."""

from __future__ import annotations

import os
import shutil
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from saflite.contract.plain import argument, plain, plain_json, word

FOLD_MIN = 24
LINE_MAX = 1_500
"""Characters of one complaint."""


def line(text: str = "") -> None:
    """Write one line of text."""
    _write(plain(text) + "\n")


def flush() -> None:
    """Hand what was written to whoever reads it; raises OSError that names standard output where it takes no more."""
    with _named_stdout():
        sys.stdout.flush()


def _write(text: str) -> None:
    with _named_stdout():
        sys.stdout.write(text)


@contextmanager
def _named_stdout() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as fault:
        raise OSError(fault.errno, fault.strerror, "standard output") from fault


def complain(kind: str, text: str) -> None:
    """Write one line to stderr, if it can be; line breaks are folded, and what nobody reads to its end is cut."""
    said = " ".join(text.split())
    shown = f"saflite: {kind}: {word(said if len(said) <= LINE_MAX else f'{said[:LINE_MAX]}...')}\n"
    for stream, words in ((sys.stdout, ""), (sys.stderr, shown)):
        try:
            stream.write(words)
            stream.flush()
        except OSError:
            mute(stream)


_warned: set[str] = set()
"""What the command under way has warned of."""


def begin() -> None:
    """Begin another command: what the one before it warned of is told again.

    Warnings of libraries are for whoever programs (`python -W`): a recording of others, of numbers that are none, would
    have lines of our code told instead of one of ours.
    """
    _warned.clear()
    if not sys.warnoptions:
        warnings.simplefilter("ignore", RuntimeWarning)


def warn_once(text: str) -> None:
    """Write a warning to stderr, as `complain` does, unless this command has: it may read a file several times."""
    if text not in _warned:
        _warned.add(text)
        complain("warning", text)


def json(value: Any) -> None:
    """Write `value` (structs, mappings, numbers; bytes become base64) as one line of JSON."""
    import msgspec

    _write(plain_json(msgspec.json.encode(value, order="deterministic").decode()) + "\n")
    flush()


def table(rows: Iterable[Sequence[object]], headers: Sequence[str] = (), indent: str = "") -> None:
    """Write rows in columns as wide as their widest cell; the last column is ragged, and folded on a terminal."""
    cells = [[word(str(cell)) for cell in row] for row in rows]
    if headers:
        cells.insert(0, [str(head) for head in headers])
    if not cells:
        return
    widths = [max(len(row[column]) for row in cells if column < len(row)) for column in range(max(map(len, cells)))]
    for row in cells:
        padded = [cell.ljust(width) for cell, width in zip(row[:-1], widths, strict=False)]
        line(folded(indent + "".join(f"{cell}  " for cell in padded), row[-1]))


def folded(before: str, text: str) -> str:
    """Return a text behind what stands before it, folded below itself to the width of a terminal; a line in a pipe.

    A text that would be left less than `FOLD_MIN` characters of width stays one line, too.
    """
    width = shutil.get_terminal_size().columns - len(before)
    if not sys.stdout.isatty() or width < FOLD_MIN or len(text) <= width or not text.strip():
        return f"{before}{text}".rstrip()
    import textwrap

    first, *rest = textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False)
    return "\n".join([before + first, *(" " * len(before) + more for more in rest)])


def summary_of(path: Path) -> str:
    """Return the first line of a Python file's docstring without importing it; empty if there is none."""
    with path.open(encoding="utf-8") as file:
        first = file.readline().strip()
    return first.strip('"').strip() if first.startswith('"""') else ""


def program() -> str:
    """Return how this command is called: `saflite`, or where it lies if it is not on the path."""
    import shutil

    called = Path(sys.argv[0])
    if shutil.which("saflite") or called.name != "saflite":
        return "saflite"
    here = Path.cwd()
    return argument(called.relative_to(here) if called.is_relative_to(here) else called)


def mute(stream: TextIO) -> None:
    """Stop writing for good: the reader has gone, or the disk is full; what is still buffered must fail nobody."""
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def open_closed() -> None:
    """Let standard input, output and errors that were closed lead nowhere.

    Python has none then, and the next file opened, of a run maybe, would stand where libraries write what they say.
    """
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)  # the lowest that is free, so the one that is missing
            setattr(sys, name, os.fdopen(handle, "r" if name == "stdin" else "w", closefd=False))
