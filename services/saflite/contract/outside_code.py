"""Code from outside that raises: its own fault, told by name and line, and never taken for one of ours."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from saflite.contract.errors import FarmError, RefusedElsewhere
from saflite.contract.interrupts import interrupts
from saflite.contract.modules import Kind

OURS = str(Path(__file__).parents[1])


class Raised(RefusedElsewhere):
    """Code from outside raised what no caller expects. `what` says who, what and where; the text also why."""


@contextmanager
def of_outside(kind: Kind, name: str, *, outside: bool = True) -> Iterator[None]:
    """Tell what the body raises as the fault of a module from outside; of one of ours it stays our own.

    Raises:
        Raised: it raised anything but the errors that its kind may.
        KeyboardInterrupt: somebody pressed Ctrl-C meanwhile.
    """
    if not outside:
        yield
        return
    try:
        with interrupts() as interrupted:
            yield
    except FarmError:
        raise
    except BaseException as fault:  # a panic of a Rust package is no Exception, nor is what `sys.exit` raises
        if interrupted():
            raise KeyboardInterrupt from fault
        what = f"{kind} {name} raised {type(fault).__name__}{_place(fault)}"
        why = str(fault).partition("\n")[0][:200]
        raise Raised(what, f"{what}: {why}" if why else what) from fault


def _place(fault: BaseException) -> str:
    """Return the file where code from outside begins and the line in it that was reached, empty if there is none."""
    frames = [one for one in traceback.extract_tb(fault.__traceback__) if not one.filename.startswith(OURS)]
    if not frames:
        return ""
    line = next(one.lineno for one in reversed(frames) if one.filename == frames[0].filename)
    return f" ({Path(frames[0].filename).name} line {line})"
