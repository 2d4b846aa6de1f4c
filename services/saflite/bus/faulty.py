"""The bus in memory with seeded trouble: messages lost, doubled, late, out of order, networks cut in two."""

from __future__ import annotations

from typing import NamedTuple

from saflite.bus.memory import Hop, MemoryNetwork
from saflite.contract.rng import derive


class Trouble(NamedTuple):
    """How bad it is. Shares lie in 0..1; a random delay also changes the order of messages."""

    loss: float = 0.3
    duplicate: float = 0.1
    delay_max_s: float = 0.5
    presence_loss: float = 0.0


class FaultyNetwork(MemoryNetwork):
    """A memory network with trouble drawn from `rng_seed`; equal seeds and calls give equal trouble."""

    def __init__(self, rng_seed: int, trouble: Trouble) -> None:
        super().__init__()
        self.trouble = trouble
        self.lost = self.doubled = self.cut = 0
        self._rng = derive(rng_seed, "faulty-bus")
        self._island: frozenset[str] = frozenset()

    def part(self, names: frozenset[str]) -> None:
        """Cut the participants in `names` off from all others, both ways, until `heal`."""
        self._island = names

    def heal(self) -> None:
        """Join the two parts again."""
        self._island = frozenset()

    def delays_s(self, hop: Hop, source: str, destination: str) -> tuple[float, ...]:
        """Return one delay per copy that arrives; none where the message is lost or the network is cut."""
        if (source in self._island) != (destination in self._island):
            self.cut += 1
            return ()
        loss = self.trouble.presence_loss if hop == "presence" else self.trouble.loss
        lost, doubled, first, second = self._rng.random(4).tolist()
        if lost < loss:
            self.lost += 1
            return ()
        delay_s = first * self.trouble.delay_max_s
        if doubled >= self.trouble.duplicate or hop == "presence":
            return (delay_s,)
        self.doubled += 1
        return (delay_s, second * self.trouble.delay_max_s)
