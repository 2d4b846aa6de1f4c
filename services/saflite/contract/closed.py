"""What others can change is not believed: whether it is this user's own, or root's, and closed to others."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from pathlib import Path

from saflite.contract.errors import Refused
from saflite.contract.plain import argument


def check_closed(path: Path | str, what: str, doubt: str = "if what is in it is still yours") -> None:
    """Raise Refused where a folder or file is another user's, or others can write in it.

    `doubt` says what the user has to look at before it is closed: others may have been there. Links are followed.

    Raises:
        Refused: as said.
        OSError: it cannot be looked at.
    """
    found = os.stat(path)
    kind, inside = ("folder", "write in") if stat.S_ISDIR(found.st_mode) else ("file", "write to")
    if found.st_uid not in (0, os.geteuid()):
        got = f"one of user {found.st_uid}"
        fix = f"work on a copy (cp -r), or have the {kind} given to you (chown -R)"
    elif found.st_mode & stat.S_IWOTH:
        got, fix = f"one that anybody can {inside}", f"chmod o-w the {kind}, {doubt}"
    elif found.st_mode & stat.S_IWGRP and not _is_ones_own(found.st_gid):
        got, fix = f"one that others of its group can {inside}", f"chmod g-w the {kind}, {doubt}"
    elif "system.posix_acl_access" in _attributes(path) and found.st_mode & stat.S_IWGRP:
        got, fix = f"one that an access list lets others {inside}", f"setfacl -b the {kind}, {doubt}"
    else:
        return
    raise Refused(what, where=str(path), expected="one of your own or root's", got=got, fix=fix)


def check_private(found: os.stat_result, path: Path, what: str) -> None:
    """Raise Refused for a file with a secret that others can open, or that another user has put there."""
    if found.st_mode & 0o077:
        fix = f"chmod 600 {argument(path)}"
        raise Refused(what, where=str(path), expected="mode 0600", got="one that others can read", fix=fix)
    if found.st_uid not in (0, os.geteuid()):
        got, fix = f"one of user {found.st_uid}", "have it given to you (chown), if what is in it is yours"
        raise Refused(what, where=str(path), expected="a file of your own or root's", got=got, fix=fix)


def _is_ones_own(group: int) -> bool:
    """Return whether a group bears our user's name and has nobody else in it, as most systems make one."""
    try:
        name, found = pwd.getpwuid(os.geteuid()).pw_name, grp.getgrgid(group)
    except KeyError:
        return False
    return found.gr_name == name and set(found.gr_mem) <= {name}


def _attributes(path: Path | str) -> list[str]:
    try:
        return os.listxattr(path)
    except OSError:
        return []  # a file system without any has no access lists either
