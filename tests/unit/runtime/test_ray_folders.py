"""What a role of `--on ray` was given, a private key among it, does not stay on its node.

Ray itself is not needed: a stand-in runs actors here, and kills one as Ray does, without a word to it.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from saflite.runtime.launchers.base import Meeting, RoleSpec, RoleState

SPEC = RoleSpec(kind="record", name="record-1")
MEETING = Meeting(campaign="night", connect="tcp/127.0.0.1:1", insecure=True, patience_s=1.0)


class _Question:
    def __init__(self, do: Callable[..., Any]) -> None:
        self._do = do

    def remote(self, *args: Any) -> Any:
        return self._do(*args)


class _Actor:
    def __init__(self, place: Any) -> None:
        self.place = place

    def __getattr__(self, name: str) -> _Question:
        return _Question(getattr(self.place, name))


class _Kind:
    def __init__(self, kind: Callable[..., Any]) -> None:
        self._kind = kind

    def options(self, **_: Any) -> _Kind:
        return self

    def remote(self, *args: Any) -> _Actor:
        return _Actor(self._kind(*args))


class Roles:
    """Roles of a node, which end when they are told."""

    condition = "running"

    def __init__(self, meeting: Meeting, folder: Path, **_: Any) -> None:
        (folder / "logs").mkdir()

    def start(self, spec: RoleSpec) -> None:
        """Begin."""
        self._name = spec.name

    def poll(self) -> dict[str, RoleState]:
        """Say how they are."""
        return {self._name: RoleState(Roles.condition)}  # type: ignore[arg-type]

    def stop(self) -> None:
        """End."""


def _kill(actor: _Actor, *, no_restart: bool) -> None:
    actor.__dict__.pop("place")  # its process is gone: nothing of it is called any more


@pytest.fixture
def launcher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The launcher of a cluster whose nodes have their temporary folder here."""
    ray: Any = ModuleType("ray")
    ray.exceptions = ModuleType("ray.exceptions")
    for name in ("GetTimeoutError", "RayActorError", "RayError"):
        setattr(ray.exceptions, name, type(name, (Exception,), {}))
    ray.remote, ray.kill = _Kind, _kill
    ray.wait = lambda asked, **_: (asked, [])
    ray.get = lambda answer: answer
    ray.is_initialized, ray.cluster_resources, ray.shutdown = lambda: True, lambda: {"CPU": 1.0}, lambda: None
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.setitem(sys.modules, "ray.exceptions", ray.exceptions)
    monkeypatch.delitem(sys.modules, "saflite.runtime.launchers.ray", raising=False)
    module = import_module("saflite.runtime.launchers.ray")
    monkeypatch.setattr(module, "LocalLauncher", Roles)
    monkeypatch.setattr(Roles, "condition", "running")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "key.pem").write_text("secret")
    before = signal.getsignal(signal.SIGCHLD)
    yield module.RayLauncher(MEETING, keys=tmp_path / "keys")
    signal.signal(signal.SIGCHLD, before)
    sys.modules.pop("saflite.runtime.launchers.ray")


def _keys(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "tmp").rglob("key.pem"))


@pytest.mark.parametrize("condition", ["finished", "refused", "broken", "killed"])
def test_a_role_that_ends_leaves_nothing_on_its_node(
    condition: str, launcher: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):
        monkeypatch.setattr(Roles, "condition", "running")
        launcher.start(SPEC)
        assert len(_keys(tmp_path)) == 1, "the role was given its key"
        monkeypatch.setattr(Roles, "condition", condition)
        while launcher.poll()[SPEC.name].condition == "running":
            pass
        assert list((tmp_path / "tmp").iterdir()) == []


def test_a_role_that_is_stopped_leaves_nothing_on_its_node(launcher: Any, tmp_path: Path) -> None:
    launcher.start(SPEC)
    assert len(_keys(tmp_path)) == 1
    launcher.close()
    assert list((tmp_path / "tmp").iterdir()) == []


def test_what_a_killed_actor_left_is_swept_and_what_a_living_one_has_is_not(launcher: Any, tmp_path: Path) -> None:
    others = tmp_path / "tmp" / "saflite-else"
    others.mkdir()
    link = tmp_path / "tmp" / "saflite-on-ray-link-x"
    link.symlink_to(tmp_path / "keys")
    launcher.start(SPEC)
    (left,) = _keys(tmp_path)
    launcher.start(_another("record-2"))
    assert len(_keys(tmp_path)) == 2
    assert left in _keys(tmp_path), "that of one that lives was taken away"
    _die(launcher, SPEC.name)
    launcher.start(_another("record-3"))
    assert left not in _keys(tmp_path)
    assert len(_keys(tmp_path)) == 2
    assert others.is_dir()
    assert (tmp_path / "keys" / "key.pem").exists(), "a link was followed"


def _another(name: str) -> RoleSpec:
    return RoleSpec(kind="record", name=name)


def _die(launcher: Any, name: str) -> None:
    """Have the process of an actor end as by SIGKILL: all it held open is closed, nothing else is done."""
    actor = launcher._placed.pop(name).actor
    os.close(actor.place._lock)
    _kill(actor, no_restart=True)
