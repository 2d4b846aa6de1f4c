"""Modules from outside the package: files named with `--module`, given to a process once, at its start.

What a file is, what it offers says: a target (`describe`, `check`, `open`), a strategy (class `Strategy`), a scorer
(class `Model`), or a policy (TOML with a formula). It goes by the name of its file, a policy by its id.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterable, Sequence
from importlib.machinery import SOURCE_SUFFIXES, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Literal

import msgspec

from saflite.contract.bounds import Word
from saflite.contract.errors import Refused
from saflite.contract.ids import digest
from saflite.contract.names import Digest, Name
from saflite.contract.outside import TEXT_BYTES_MAX, as_text, check_file, parse_toml, read_bytes

Kind = Literal["target", "strategy", "scorer", "policy"]
KINDS = "a target (describe, check, open), a strategy (class Strategy), a scorer (class Model) or a policy (.toml)"
OFFERED: dict[Kind, tuple[str, ...]] = {
    "target": ("describe", "check", "open"),
    "strategy": ("proposes", "options", "tell", "ask"),
    "scorer": ("score", "warm", "close"),
}
_MAIN: dict[str, Kind] = {"describe": "target", "open": "target", "Strategy": "strategy", "Model": "scorer"}


class Outside(msgspec.Struct, frozen=True, kw_only=True):
    """A module from outside: what it is, its name, where it lies, and the SHA-256 of its content."""

    kind: Kind
    name: Name
    file: Word
    digest: Digest

    @property
    def key(self) -> str:
        """What it is, in two words: kind and name."""
        return f"{self.kind} {self.name}"

    @property
    def path(self) -> Path:
        """Where it lies."""
        return Path(self.file)


_given: dict[tuple[Kind, str], Outside] = {}


def use(files: Iterable[Path], digests: Sequence[str] = ()) -> tuple[Outside, ...]:
    """Let this process find the modules in `files`; the later of two of one kind and name counts.

    Args:
        files: where they lie.
        digests: of the content of each that may be run, where it was looked at before; of any if there are none.

    Raises:
        Refused: one cannot be read or run, is none of the kinds, lacks what its kind needs, or has another content.
    """
    readable = [check_file(path, "module") for path in files]  # told under the name it was given
    wanted = [*digests, *([""] * (len(readable) - len(digests)))]
    found = tuple(_read(Path(os.path.realpath(path)), one) for path, one in zip(readable, wanted, strict=True))
    _given.update({(module.kind, module.name): module for module in found})
    return found


def given(kind: Kind) -> dict[str, Outside]:
    """Return the modules of a kind this process was given, by name."""
    return {name: module for (its_kind, name), module in _given.items() if its_kind == kind}


def all_given() -> tuple[Outside, ...]:
    """Return every module this process was given."""
    return tuple(_given.values())


def forget() -> None:
    """Find none of them any more (tests)."""
    _given.clear()


def load_file(path: Path) -> ModuleType:
    """Return the Python module in a file, run once per content; raises Refused if there is none or it does not run."""
    return _loaded(path, _bytes(path))


def _loaded(path: Path, content: bytes) -> ModuleType:
    name = f"saflite_module_{path.stem}_{digest(content)[:16]}"
    known = sys.modules.get(name)
    if known is not None and known.__file__ == str(path):
        return known
    if path.suffix not in SOURCE_SUFFIXES:
        raise Refused("module", where=str(path), expected="a Python file", got=path.suffix or "no suffix")
    spec = importlib.util.spec_from_file_location(name, path, loader=_AsRead(name, str(path), content))
    assert spec is not None, "it has a loader"
    assert spec.loader is not None, "it has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException as fault:  # it may call `sys.exit`, too, which would end this process without a word
        del sys.modules[name]
        if isinstance(fault, KeyboardInterrupt):
            raise
        got = f"{type(fault).__name__}: {fault}".splitlines()[0].removesuffix(": ")
        raise Refused("module", where=str(path), expected="Python that runs", got=got) from fault
    return module


class _AsRead(SourceFileLoader):
    """Runs what was read: compiled code that lies beside a file may be of what stood there before, or of a stranger."""

    def __init__(self, name: str, path: str, content: bytes) -> None:
        super().__init__(name, path)
        self._content = content

    def get_code(self, fullname: str) -> CodeType:
        """Return the code of the content."""
        return compile(self._content, self.path, "exec", dont_inherit=True)


def _bytes(path: Path) -> bytes:
    return read_bytes(path, "module", TEXT_BYTES_MAX)


def _read(path: Path, wanted: str) -> Outside:
    content = _bytes(path)  # once: what is run is what was looked at, whatever stands there a moment later
    told = digest(content)
    if wanted not in ("", told):
        raise Refused(
            "module", where=str(path), expected="the content that it had when it was looked at", got="another"
        )
    if path.suffix == ".toml":
        return Outside(kind="policy", name=_policy_id(path, content), file=str(path), digest=told)
    module = _loaded(path, content)
    kind = next((kind for name, kind in _MAIN.items() if hasattr(module, name)), None)
    if kind is None:
        raise Refused("module", where=str(path), expected=KINDS, got="none of these in it")
    owner = module if kind == "target" else getattr(module, "Strategy" if kind == "strategy" else "Model")
    lacking = [name for name in OFFERED[kind] if not hasattr(owner, name)]
    if lacking:
        expected = f"a {kind} with {', '.join(OFFERED[kind])}"
        raise Refused("module", where=str(path), expected=expected, got=f"one without {', '.join(lacking)}")
    return Outside(kind=kind, name=path.stem, file=str(path), digest=told)


def _policy_id(path: Path, content: bytes) -> str:
    data = parse_toml(as_text(content, path, "module"), "module", str(path))
    if "formula" not in data or not isinstance(data.get("id"), str):
        raise Refused(
            "module", where=str(path), expected="a policy, with an id and a formula", got="a TOML file without"
        )
    return str(data["id"])
