"""Joining a farm: who wants to work says what it is, before any work is asked for; the books accept or refuse it.

The key of this conversation holds no protocol number and its fields stay readable to every version (only fields with
defaults are added, none is ever taken away), so that a mismatch can be told in words instead of silence.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from saflite.contract.bounds import Account, Count, Labels, Seconds, Word
from saflite.contract.errors import Refused
from saflite.contract.names import NAME_EXPECTED, is_name
from saflite.contract.work import TARGETS_MAX, Stage, TargetBuild


class Join(msgspec.Struct, frozen=True, kw_only=True):
    """A worker wants to join.

    `worker` is the name it wants, its own in the farm; `session` names this life of it. `software` is the digest of the
    code that decides what its stage answers, `version` that of the package. `targets` are those it can
    fly, with their builds; `modules` the modules from outside it was given, as `Outside.key` names them, each with
    the SHA-256 of its content.
    """

    protocol: Count
    worker: Word = ""
    session: Word = ""
    stage: Stage = "fly"
    version: Word = ""
    software: Word = ""
    targets: Annotated[tuple[TargetBuild, ...], msgspec.Meta(max_length=TARGETS_MAX)] = ()
    modules: Labels = {}
    host: Word = ""
    cores: Count = 0
    gpus: Count = 0
    labels: Labels = {}

    def build_of(self, target: str) -> str:
        """Return the build of a target this worker can fly, empty if that is not known."""
        return next((one.build for one in self.targets if one.name == target), "")


class Joined(msgspec.Struct, frozen=True, kw_only=True):
    """The answer: accepted under `worker` and `session`, or refused, and `message` says why.

    `protocol` and `version` are those of the books; `target` is what the campaign flies. Who is refused for now only is
    told after how long to ask again, `retry_after_s`; it is 0 where asking again would change nothing.
    """

    accepted: bool
    message: Account = ""
    protocol: Count = 0
    version: Word = ""
    worker: Word = ""
    session: Word = ""
    campaign: Word = ""
    target: Word = ""
    lease_s: Seconds = 0.0
    retry_after_s: Seconds = 0.0


def check_worker_name(name: str) -> str:
    """Return the name; raises Refused unless it is one that can stand in keys, paths and tables as it is."""
    if not is_name(name):
        raise Refused("worker name", expected=NAME_EXPECTED, got=repr(name[:80]))
    return name
