"""The three kinds of trouble, which never share a channel.

    FarmError
      Refused       the caller's input is wrong: say what, where, expected, got, fix          exit code 2
      Unavailable   something we depend on is not there (bus, disk, model server): retry      exit code 3

Broken invariants of our own are plain `AssertionError`: the process dies and its leases are freed.
"""

from __future__ import annotations

from collections.abc import Iterable


class FarmError(Exception):
    """Root of the errors a caller may handle."""


class Refused(FarmError):
    """Input that cannot be accepted, told in one line.

    Args:
        what: what was looked at, e.g. `obstacle 2` or `campaign file`.
        where: file, line, key or argument where it stands; empty if there is none.
        expected: what would have been accepted.
        got: what was found instead.
        fix: what the user can do; empty if `expected` says it all.
        known: the names there are; `expected` tells them where it is `one of A, B, ...`. A near one is suggested.
    """

    def __init__(
        self, what: str, *, expected: str, got: object, where: str = "", fix: str = "", known: Iterable[str] = ()
    ) -> None:
        self.what, self.where, self.expected, self.got, self.fix = what, where, expected, got, fix
        place = f" ({where})" if where else ""
        near = (
            _near(got, known or expected.removeprefix("one of ").split(", ")) if known or "one of " in expected else ""
        )
        self.fix = fix = "; ".join(filter(None, (f"did you mean {near}?" if near else "", fix)))
        remedy = f"; {fix}" if fix else ""
        super().__init__(f"{what}{place}: expected {expected}, got {got}{remedy}")

    def __reduce__(self) -> tuple[object, ...]:
        """Return what makes it again in another process, as pools of processes do with what a task raised."""
        return _made_again, (type(self), str(self), self.__dict__)


def _made_again(kind: type[Refused], text: str, fields: dict[str, object]) -> Refused:
    found = kind.__new__(kind, text)
    found.__dict__.update(fields)
    return found


class RefusedElsewhere(Refused):
    """What another process refused, in the words it found for it."""

    def __init__(self, what: str, told: str) -> None:
        self.what, self.where, self.expected, self.got, self.fix = what, "", "", told, ""
        FarmError.__init__(self, told)


def _near(got: object, known: Iterable[str]) -> str:
    """Return the known name that is most like what was given, empty if none is."""
    import difflib

    found = difflib.get_close_matches(str(got).strip("'\""), [name.strip() for name in known], 1)
    return found[0] if found else ""


class Unavailable(FarmError):
    """A dependency did not answer; trying again later may help."""


def pip_install(*what: str) -> str:
    """Return the command that installs packages where this program runs, whatever is activated in the shell."""
    import shlex
    import sys

    return shlex.join((sys.executable, "-m", "pip", "install", *what))


def not_installed(what: str, extra: str) -> Unavailable:
    """Return what to raise where packages of an extra are missing; names those packages, wherever ours came from."""
    from importlib.metadata import requires

    lines = [line.partition(";") for line in requires("saflite-farm") or ()]
    wanted = [name.strip() for name, _, marker in lines if f'extra == "{extra}"' in marker.replace("'", '"')]
    return Unavailable(f"{what} not installed: {pip_install(*wanted)}")
