"""Logs of the farm's processes: lines for people, or one JSON object a line for machines.

An object holds `time` (RFC 3339, UTC), `level`, `campaign`, `role`, `worker`, `event` (what happened, in words),
`logger`, and `test_case`, `lease`, `fact` and `traceback` where there is one.
"""

from __future__ import annotations

import json
import logging
import sys
import traceback
from copy import copy
from datetime import UTC, datetime

import msgspec

from saflite.contract.events import Fact
from saflite.contract.plain import cut, plain, plain_json, word
from saflite.contract.test_case import identity
from saflite.contract.work import Work

TEXT = "%(asctime)s %(levelname).1s %(name)s: %(message)s"
MESSAGE_CHARS_MAX = 4_096
"""Books that refuse a worker ten times a second with the longest words there may be would fill its disk in a night."""

WORK_LOG = logging.getLogger("saflite.work")
"""One line for each piece of work begun and done: only where machines read the log."""


class JsonLines(logging.Formatter):
    """Formats a record as one line of JSON."""

    def __init__(self, campaign: str, role: str, worker: str) -> None:
        super().__init__()
        self._who = {"campaign": campaign, "role": role, "worker": worker}

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            **self._who,
            "event": cut(record.getMessage(), MESSAGE_CHARS_MAX),
            "logger": record.name,
        }
        line |= {name: getattr(record, name) for name in ("test_case", "lease", "fact") if hasattr(record, name)}
        if record.exc_info:
            line["traceback"] = "".join(traceback.format_exception(*record.exc_info))
        return plain_json(json.dumps(line, ensure_ascii=False))


class TextLines(logging.Formatter):
    """Formats a record for people; what workers and servers said in it steers no terminal it is shown on.

    Nor does it look like lines of ours: what is said is one line, and no longer than anybody would read.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, and the traceback if there is one."""
        said = copy(record)
        said.msg, said.args = word(cut(record.getMessage(), MESSAGE_CHARS_MAX)), None
        return plain(super().format(said))


def begin(campaign: str, role: str, worker: str, *, as_json: bool) -> None:
    """Send this process's log to standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines(campaign, role, worker) if as_json else TextLines(TEXT))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    WORK_LOG.setLevel(logging.INFO if as_json else logging.WARNING)


def event_of(line: str) -> str:
    """Return what a JSON line says happened; the line itself if it is none."""
    try:
        told = json.loads(line)
    except (json.JSONDecodeError, RecursionError):
        return line
    return str(told["event"]) if isinstance(told, dict) and "event" in told else line


def log_fact(fact: Fact) -> None:
    """Write the line of a fact, with what it says in single values: who joined, what went wrong."""
    if not WORK_LOG.isEnabledFor(logging.INFO):
        return
    said: dict[str, object] = msgspec.to_builtins(fact)
    found = said.pop("violation", None)
    said = {**said, **(found if isinstance(found, dict) else {})}
    single = {name: value for name, value in said.items() if isinstance(value, str | bool | int | float)}
    kind, case = single.pop("type"), single.pop("test_case", "")
    WORK_LOG.info(kind, extra={"fact": single, **({"test_case": case} if case else {})})


def about(work: Work, lease: str) -> dict[str, str]:
    """Return what a log line should hold about a piece of work: its lease, and its test case if it is about one."""
    case = getattr(work, "test_case", None)
    return {"lease": lease, **({"test_case": identity(case)} if case is not None else {})}
