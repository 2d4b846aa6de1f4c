"""The command line: `saflite COMMAND ...`. A command is one file under `commands/`; nothing else is imported before it.

Exit codes: 0 nothing found, 1 violations found, 2 refused input, 3 infrastructure, 4 nothing judged.
"""

from __future__ import annotations

import argparse
import atexit
import errno
import re
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

from saflite.console.io.arguments import plain_number, plain_whole
from saflite.console.view import out
from saflite.contract.errors import Refused, Unavailable

NOTHING_FOUND, FOUND, REFUSED, INFRASTRUCTURE, NOTHING_JUDGED = 0, 1, 2, 3, 4
INTERRUPTED = 130
BROKEN_PIPE = 141  # 128 and SIGPIPE, as the shell has it
NO_PLACE = (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.EINVAL)
"""What the system says of a path that can be none, or is of another kind than what was asked for."""
NO_MEMORY = ("failed to map segment", "Cannot allocate memory")  # as the loader of libraries has it
NO_TEMPORARY = "No usable temporary directory"
"""As `tempfile` has it where no folder takes a file: it says that none was found, whatever the system said."""
NUL_IN_PATH = "embedded null byte"  # a ValueError, as Python has it; no argument holds one, a path in a file may
NO_TEXT = "surrogates not allowed"  # why Python encodes no name of a folder that is no UTF-8
_ORDER = ("run", "resume", "replay", "watch", "report", "list")


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line instead of a page; numbers are plain ones."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.register("type", int, plain_whole)
        self.register("type", float, plain_number)
        self._options_only = False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Take options out first, wherever they stand before `--`; then all other words together.

        argparse alone gives an argument of no or many words those up to the next option, and refuses the rest.
        """
        words = list(sys.argv[1:] if args is None else args)
        if self._subparsers is not None:  # its verbs are parsers of this kind
            return super().parse_known_args(words, namespace)
        end = words.index("--") if "--" in words else len(words)
        options = [action for action in self._actions if action.option_strings]
        others = [action for action in self._actions if not action.option_strings]
        self._options_only = True
        try:
            with _not_required(others):
                namespace, loose = super().parse_known_args(words[:end], namespace)
        finally:
            self._options_only = False
        with _not_required([*options, *self._mutually_exclusive_groups]):  # they were there, or this is not come to
            return super().parse_known_args([*loose, *words[end:]], namespace)

    def _get_positional_actions(self) -> list[argparse.Action]:
        return [] if self._options_only else super()._get_positional_actions()

    def error(self, message: str) -> NoReturn:
        """Raise Refused where argparse would print its usage."""
        near = _near_argument(message, self._option_string_actions)
        fix = "; ".join(filter(None, (near, f"see `{self.prog} --help`")))
        raise Refused(self.prog, expected="valid arguments", got=message, fix=fix)

    def print_help(self, file: Any = None) -> None:
        """Write help as all output is written: argparse keeps to itself that it could not be."""
        out.line(self.format_help().rstrip("\n"))
        out.flush()


@contextmanager
def _not_required(parts: Sequence[argparse.Action | argparse._MutuallyExclusiveGroup]) -> Iterator[None]:
    """Have argparse miss none of these for as long as it is open."""
    needed = [part for part in parts if part.required]
    try:
        for part in needed:
            part.required = False
        yield
    finally:
        for part in needed:
            part.required = True


def _near_argument(message: str, options: Iterable[str]) -> str:
    """Return a question after the choice or option that is most like the one argparse does not know, empty if none."""
    import difflib

    after = re.search(r"unrecognized arguments: .*?(--?[a-z][\w-]*)", message)
    if after and after[1] in options:
        return f"{after[1]} goes before `--`, after which all words are names"
    choice = re.search(r"invalid choice: '([^']*)' \(choose from (.*)\)", message)
    option = re.search(r"unrecognized arguments: (--[^\s=]+)", message)
    if choice:
        near = difflib.get_close_matches(choice[1], re.findall(r"[\w.-]+", choice[2]), 1)
    else:
        near = difflib.get_close_matches(option[1], options, 1) if option else []
    return f"did you mean {near[0]}?" if near else ""


def command_names() -> tuple[str, ...]:
    """Return the names of all commands, the most used first."""
    folder = Path(__file__).parent / "commands"
    found = {path.stem.rstrip("_").replace("_", "-") for path in folder.glob("*.py") if path.stem != "__init__"}
    first = tuple(name for name in _ORDER if name in found)
    return first + tuple(sorted(found - set(first)))


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; faults of the user or of a dependency become one line on stderr."""
    words = list(sys.argv[1:] if argv is None else argv)
    out.open_closed()
    out.begin()
    _hear_of_children()
    try:
        code = _dispatch(words)
        out.flush()
        return code
    except Refused as fault:
        out.complain("refused", str(fault))
        return REFUSED
    except Unavailable as fault:
        out.complain("unavailable", str(fault))
        return INFRASTRUCTURE
    except KeyboardInterrupt as fault:
        out.complain("interrupted", str(fault) or "stopped by the keyboard")
        return INTERRUPTED
    except BrokenPipeError:
        out.mute(sys.stdout)
        return BROKEN_PIPE
    except OSError as fault:
        text = f"{str(fault.filename)[:200]}: {fault.strerror}" if fault.filename else _in_a_line(fault)
        if NO_TEMPORARY in str(fault):
            text = "no folder for temporary files takes one (TMPDIR): full, read-only, or files are limited (ulimit -f)"
        if fault.errno in NO_PLACE:
            out.complain("refused", text)
            return REFUSED
        out.complain("unavailable", text)
        return INFRASTRUCTURE
    except MemoryError:
        out.complain("unavailable", "this process was given too little memory")
        return INFRASTRUCTURE
    except ImportError as fault:
        if not any(words in str(fault) for words in NO_MEMORY):
            return _own_fault(fault)
        out.complain("unavailable", f"this process was given too little memory: {_in_a_line(fault)}")
        return INFRASTRUCTURE
    except ValueError as fault:
        if str(fault) != NUL_IN_PATH and not (isinstance(fault, UnicodeEncodeError) and fault.reason == NO_TEXT):
            return _own_fault(fault)
        out.complain("refused", "a path holds a NUL" if str(fault) == NUL_IN_PATH else "a path is no text in UTF-8")
        return REFUSED
    except (SystemExit, GeneratorExit):
        raise
    except BaseException as fault:  # noqa: BLE001 (exit code 1, Python's own, must only mean violations; Rust panics)
        return _own_fault(fault)


def command() -> NoReturn:
    """Run what the command line says, and leave: at once where Zenoh was used, whose threads may hang at the end."""
    code: str | int | None = INFRASTRUCTURE
    try:
        code = main()
    except SystemExit as ended:
        code = ended.code
    if "zenoh" in sys.modules and isinstance(code, int):
        from saflite.bus.zenoh import leave_process

        atexit._run_exitfuncs()
        with suppress(OSError, ValueError):  # closed
            sys.stdout.flush()
        leave_process(code)
    sys.exit(code)


def _hear_of_children() -> None:
    """Let the kernel tell how our processes end, where whoever started us asked it not to: a dead one looked well."""
    with suppress(ValueError):  # not the main thread
        if signal.getsignal(signal.SIGCHLD) == signal.SIG_IGN:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def _own_fault(fault: BaseException) -> int:
    out.complain("fault of saflite itself", f"{_in_a_line(fault)}; the traceback is in {_kept_traceback()}")
    return INFRASTRUCTURE


def _in_a_line(fault: BaseException) -> str:
    text = str(fault).splitlines()
    return f"{type(fault).__name__}: {text[0][:200]}" if text else type(fault).__name__


def _kept_traceback() -> str:
    """Write the traceback of the exception at hand to a file of its own and return where; say so if even that fails."""
    import tempfile
    import traceback

    try:
        with tempfile.NamedTemporaryFile("w", prefix="saflite-", suffix=".log", delete=False) as file:
            traceback.print_exc(file=file)
    except OSError as fault:
        return f"no file ({fault})"
    return file.name


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        out.line(_overview())
        return NOTHING_FOUND
    if words[0] == "--version":
        out.line(f"saflite {_version()}")
        return NOTHING_FOUND
    module = _load(words[0])
    for word in words:
        if not _is_text(word):  # Python makes lone surrogates of other bytes, which nothing can store or send
            raise Refused("argument", expected="text in UTF-8", got=ascii(word[:200]))
    args = parser_of(words[0]).parse_args(words[1:])
    if getattr(args, "module", ()):
        from saflite.contract.modules import use

        use(args.module)
    if getattr(args, "autopilot", None) is not None:
        from saflite.console.io import named_autopilot

        named_autopilot.use(args.autopilot)
    try:
        code: int = module.run(args)
    except SystemExit as fault:  # no command raises it: code from outside did, when it was asked for something
        got = f"SystemExit: {fault.code}"
        raise Refused("code from outside", where="a module", expected="Python that runs", got=got) from fault
    return code


def _is_text(word: str) -> bool:
    return not any("\ud800" <= character <= "\udfff" for character in word)


def parser_of(name: str, parser: argparse.ArgumentParser | None = None) -> argparse.ArgumentParser:
    """Return the parser of a command's arguments, a new one if none is given; raises Refused for an unknown name."""
    module = _load(name)
    if parser is None:
        parser = _Parser(
            prog=f"saflite {name}", description=module.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
        )
    module.configure(parser)
    return parser


def whole_parser() -> argparse.ArgumentParser:
    """Return one parser that knows every command; loads all of them, which no command needs."""
    parser = _Parser(prog="saflite")
    parser.add_argument("--version", action="store_true", help="print the version")
    commands = parser.add_subparsers()
    for name in command_names():
        parser_of(name, commands.add_parser(name, help=_summary(name)))
    return parser


_FLAGS = {"version": "--version", "help": "--help"}  # what others have as commands


def _load(name: str) -> ModuleType:
    names = command_names()
    if name not in names:
        import difflib

        near = difflib.get_close_matches(name, (*names, *_FLAGS), 1)
        near = [_FLAGS.get(one, one) for one in near]
        fix = f"did you mean `saflite {near[0]}`?" if near else "see `saflite --help`"
        raise Refused("command", expected=f"any of {', '.join(names)}", got=repr(name[:80]), fix=fix)
    package = f"{__package__}.commands"
    place = name.replace("-", "_")
    folder = Path(__file__).parent / "commands"
    return import_module(f"{package}.{place if (folder / f'{place}.py').exists() else place + '_'}")


def _summary(name: str) -> str:
    """Return what a command does, in a line, without loading it."""
    place = Path(__file__).parent / "commands" / f"{name.replace('-', '_')}.py"
    return out.summary_of(place if place.exists() else place.with_stem(place.stem + "_"))


def _overview() -> str:
    rows = [out.folded(f"  {name:<11} ", _summary(name)) for name in command_names()]
    return "\n".join(
        [
            "saflite: find safety violations in autonomous vehicles, and prove them",
            "",
            "usage: saflite COMMAND [...]        saflite COMMAND --help",
            "",
            *rows,
            "",
            "first steps: saflite run avoidance-m2",
            "exit codes:  0 nothing found, 1 violations found, 2 refused input, 3 infrastructure, 4 nothing judged",
        ]
    )


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("saflite-farm")
    except PackageNotFoundError:
        return "0 (not installed)"
