"""Which modules from outside a run was made with: noted in its folder, so that `resume` and `replay` find them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from saflite.contract import modules
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.modules import Outside

FILE = "modules.json"


def note(run_dir: Path, used: Sequence[Outside]) -> None:
    """Leave in the run folder where its modules lie and the digests of their contents."""
    if not used:
        return
    try:
        (run_dir / FILE).write_bytes(msgspec.json.format(msgspec.json.encode(used)) + b"\n")
    except OSError as fault:
        raise Unavailable(f"{run_dir}: {fault}") from fault


def use(run_dir: Path, files: Sequence[Path] = ()) -> tuple[Outside, ...]:
    """Let this process find the modules of a run; `files` stand for those of the same name, and are added.

    Raises:
        Refused: one has gone or changed since the run was made and nothing stands for it.
    """
    now = modules.use(files)
    named = {(module.kind, module.name) for module in now}
    kept = [module for module in _noted(run_dir) if (module.kind, module.name) not in named]
    for module in kept:
        (found,) = modules.use([module.path])
        if found.digest != module.digest:
            fix = "restore it, or name the file that is to stand for it with --module"
            expected = f"the {module.kind} as it was when the run was made"
            raise Refused("module", where=module.file, expected=expected, got="another content", fix=fix)
    return (*kept, *now)


def _noted(run_dir: Path) -> tuple[Outside, ...]:
    try:
        return msgspec.json.decode((run_dir / FILE).read_bytes(), type=tuple[Outside, ...])
    except FileNotFoundError:
        return ()
    except (OSError, msgspec.MsgspecError) as fault:
        raise Refused("run folder", where=str(run_dir / FILE), expected="a list of modules", got=str(fault)) from fault
