"""The air around the vehicle: the scenario's wind, until a test case gives another."""

from __future__ import annotations

from saflite.contract.test_case import Wind
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.wind import WindField


class Air:
    """Blows through a world, tick by tick of 20 ms."""

    def __init__(self, world: World, wind: Wind, rng_seed: int) -> None:
        self._world, self._field = world, WindField(wind, rng_seed)
        self._moves = not self._field.still

    def change(self, mean_mps: float, from_deg: float = 0.0) -> None:
        """Replace the steady wind; gusts stay."""
        self._field.change(mean_mps, from_deg, self._field.wind.gust_mps)
        self._moves = True

    def tick(self) -> None:
        """Set the air's velocity for the next tick."""
        if self._moves:
            self._world.set_wind(*self._field.tick())
