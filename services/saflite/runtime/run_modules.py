"""Which modules from outside a run was made with: noted and copied into its folder, for `resume` and `replay`.

The file a run was made with is used while it is as it was; otherwise the copy, so that a run can go on elsewhere. Only
in runs of this user's own farms: modules are code, and a run folder may come from anybody.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from saflite.contract import modules
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import digest
from saflite.contract.modules import Kind, Outside
from saflite.contract.outside import TEXT_BYTES_MAX, read_bytes
from saflite.contract.wire import UNREADABLE, unpack_json
from saflite.evidence import own_runs

log = logging.getLogger(__name__)

FILE, FOLDER, MARK = "modules.json", "modules", "modules.mark"


def note(run_dir: Path, used: Sequence[Outside]) -> None:
    """Leave in the run folder where its modules lie, the digests of their contents, and a copy of each."""
    if not used:
        return
    try:
        for module in used:
            data = module.path.read_bytes()
            if digest(data) == module.digest:
                _copy(data, _copy_of(run_dir, module))
        noted = msgspec.json.format(msgspec.json.encode(used)) + b"\n"
        (run_dir / FILE).write_bytes(noted)
        own_runs.mark(run_dir / MARK, noted)
    except OSError as fault:
        raise Unavailable(f"{run_dir}: {fault}") from fault


def use(run_dir: Path, files: Sequence[Path] = ()) -> tuple[Outside, ...]:
    """Let this process find the modules of a run; `files` stand for those of the same name, and are added.

    Raises:
        Refused: one has gone or changed since the run was made, its copy, too, and nothing stands for it; or one is
            code, and nothing says that the run was made by this user.
    """
    now = modules.use(files)
    named = {module.key for module in now}
    noted = [module for module in _noted(run_dir) if module.key not in named]
    _check_ours(run_dir, noted)
    kept = [_intact(run_dir, module) for module in noted]
    return (*modules.use(kept, [module.digest for module in noted]), *now)


def needed(run_dir: Path, campaign: Campaign) -> tuple[Outside, ...]:
    """Return the modules of a run without which a campaign cannot go on: its target, its strategy, and all scorers."""
    names = {"target": campaign.target.name, "strategy": campaign.strategy.name}
    return tuple(module for module in _noted(run_dir) if names.get(module.kind, module.name) == module.name)


def names(run_dir: Path, kind: Kind) -> frozenset[str]:
    """Return what the modules of a kind are called that a run was made with; none of them is run."""
    return frozenset(module.name for module in _noted(run_dir) if module.kind == kind)


def _check_ours(run_dir: Path, noted: Sequence[Outside]) -> None:
    """Raise Refused where a module that is code would be run because a folder of somebody else's says so."""
    code = [module for module in noted if module.kind != "policy"]
    if code and not own_runs.is_marked(run_dir / MARK, read_bytes(run_dir / FILE, "list of modules", TEXT_BYTES_MAX)):
        copy = _copy_of(run_dir, code[0])
        raise Refused(
            "module",
            where=str(run_dir / FILE),
            expected="code that you name, in a run that no farm of yours here has made",
            got=code[0].key,
            fix=f"read it, and if you would run it: --module {copy}",
        )


def _intact(run_dir: Path, module: Outside) -> Path:
    """Return the file a module was read from, or its copy; raises Refused where neither is as it was."""
    copy = _copy_of(run_dir, module)
    if _is(module.path, module):
        return module.path
    if _is(copy, module):
        why = "has changed" if os.path.exists(module.path) else "has gone"
        log.warning(
            "%s %s since the run was made: its copy %s is used (--module takes another)", module.path, why, copy
        )
        return copy
    fix = "restore it, or name the file that is to stand for it with --module"
    expected = f"the {module.kind} as it was when the run was made"
    got = "another content" if os.path.exists(module.path) else "no such file"  # unlike Path.exists: of any name
    raise Refused("module", where=module.file, expected=expected, got=f"{got}, and no copy in {FOLDER}/", fix=fix)


def _is(path: Path, module: Outside) -> bool:
    try:
        return digest(read_bytes(path, "module", TEXT_BYTES_MAX)) == module.digest
    except Refused:
        return False


def _copy_of(run_dir: Path, module: Outside) -> Path:
    return run_dir / FOLDER / module.digest[:16] / module.path.name


def _copy(data: bytes, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_bytes() != data:
        path.write_bytes(data)


def _noted(run_dir: Path) -> tuple[Outside, ...]:
    try:
        if not os.path.lexists(run_dir / FILE):
            return ()
        data = read_bytes(run_dir / FILE, "list of modules", TEXT_BYTES_MAX)
        return unpack_json(data, tuple[Outside, ...])
    except UNREADABLE as fault:
        raise Refused("run folder", where=str(run_dir / FILE), expected="a list of modules", got=str(fault)) from fault
