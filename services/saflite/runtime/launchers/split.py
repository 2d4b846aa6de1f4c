"""Two launchers as one: the books and the router stay where the run folder is, the workers go elsewhere."""

from __future__ import annotations

from collections.abc import Collection

from saflite.runtime.launchers.base import Launcher, RoleSpec, RoleState
from saflite.runtime.supervisor import CENTRE


class SplitLauncher:
    """See `Launcher`."""

    def __init__(self, centre: Launcher, workers: Launcher) -> None:
        self._centre, self._workers = centre, workers

    def start(self, spec: RoleSpec) -> None:
        """See `Launcher.start`."""
        (self._centre if spec.kind in CENTRE else self._workers).start(spec)

    def poll(self) -> dict[str, RoleState]:
        """See `Launcher.poll`."""
        return {**self._centre.poll(), **self._workers.poll()}

    def drain(self, names: Collection[str]) -> None:
        """See `Launcher.drain`. Only workers do."""
        self._workers.drain(names)

    def stop(self, names: Collection[str] | None = None) -> None:
        """See `Launcher.stop`. Workers first."""
        self._workers.stop(names)
        self._centre.stop(names)
