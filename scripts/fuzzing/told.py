"""What the books tell workers and people, made wrong: the worker loop and the screens are given it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from farm_doubles import TARGET
from mutations import Edit, changed, drawn, encoded, steers, torn
from peer import plain
from rich.console import Console

from saflite.console.io.schema_examples import examples
from saflite.console.view import live
from saflite.console.view.event_lines import event_line
from saflite.contract import wire
from saflite.contract.blobs import BlobChunk, BlobTaken
from saflite.contract.control import Answer
from saflite.contract.errors import Refused
from saflite.contract.events import Event
from saflite.contract.join import Joined
from saflite.contract.work import Grant, Orders, Receipt
from saflite.runtime import worker as machine
from saflite.runtime.worker import Key, Worker, WorkerConfig

KINDS: dict[str, type[msgspec.Struct]] = {
    one.__name__: one for one in (Joined, Grant, Receipt, Orders, Answer, Event, BlobChunk, BlobTaken)
}


class Told:
    """Answers and events of one kind."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.kind, self.rng, self.number = KINDS[kind], rng, 0
        self.valid = [plain(one) for one in examples(self.kind).values()]
        self._screen = Console(file=Path("/dev/null").open("w"), width=120)  # noqa: SIM115
        self._worker = self._joined()

    def _joined(self) -> Worker:
        worker = Worker(WorkerConfig("w", "fly", prefetch=1), 0.0)
        worker.handle(machine.Tick(), 0.0)
        worker.handle(machine.Answered(Joined(accepted=True, worker="w", session="life", target=TARGET.name)), 0.0)
        return worker

    def step(self) -> int:
        """Tell one wrong thing; returns 1. Raises what the worker, the watcher or the screen would die of."""
        self.number += 1
        said = self.valid[self.number % len(self.valid)]
        data = encoded(drawn(said, self.rng)[0])
        return self._tell(torn(data, self.rng) if self.rng.random() < 0.1 else data)

    def say(self, edits: list[Edit]) -> None:
        """Tell each valid example with certain places changed."""
        for said in self.valid:
            for edit in edits:
                with suppress(KeyError, IndexError, TypeError):  # not in this example
                    said = changed(said, edit)
            self._tell(encoded(said))

    def _tell(self, data: bytes) -> int:
        try:
            told = wire.decode(data, self.kind)
        except Refused:
            return 1
        self._show(told) if isinstance(told, Answer | Event) else self._handle(told)
        return 1

    def _show(self, told: Answer | Event) -> None:
        if isinstance(told, Event):
            assert not steers(live.fact_text(told.fact)), told
            assert not steers(event_line(told)), told
        elif told.status is not None:
            self._screen.print(live._drawn(told.status))
            assert live.one_line(told.status)

    def _handle(self, told: Any) -> None:
        now_s = 0.1 * self.number
        worker = self._worker
        if isinstance(told, Joined):
            worker.handle(machine.Answered(told), now_s)
        elif isinstance(told, Grant):
            worker.handle(machine.Granted(told), now_s)
        elif isinstance(told, Orders):
            worker.handle(machine.Ordered(told), now_s)
        elif isinstance(told, Receipt):
            worker.handle(machine.Received(Key(told.lease_id, told.epoch), told), now_s)
        worker.handle(machine.Tick(), now_s)
        worker.validate()
        if worker.stopping or self.number % 50 == 0:
            self._worker = self._joined()

    def close(self) -> None:
        """Nothing is held."""
