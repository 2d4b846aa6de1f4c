"""Wind: steady, with gusts drawn from the test case's own stream."""

from __future__ import annotations

import math

import numpy as np

from saflite.contract.rng import derive
from saflite.contract.test_case import Wind

TICK_S = 0.02
BLOCK = 512


class WindField:
    """The wind at the vehicle, tick by tick.

    Gusts are a first-order Gauss-Markov process per axis with standard deviation `gust_mps` (a third of it
    vertically) and correlation time `gust_period_s`: the shape of the Dryden model at constant height.
    """

    def __init__(self, wind: Wind, rng_seed: int) -> None:
        self.wind = wind
        self._rng = derive(rng_seed, "wind")
        self._gust = np.zeros(3)
        self._draws = np.zeros((0, 3))
        self._next = 0
        self._blew = False

    @property
    def still(self) -> bool:
        """Whether the air does not move at all; not before a tick has told the world that it has dropped."""
        return not self._blew and self._calm

    @property
    def _calm(self) -> bool:
        return self.wind.mean_mps == 0.0 and self.wind.gust_mps == 0.0

    def change(self, mean_mps: float, from_deg: float, gust_mps: float) -> None:
        """Replace the steady wind and the size of the gusts; where there are none any more, the last one is over."""
        period_s = self.wind.gust_period_s
        self.wind = Wind(mean_mps=mean_mps, from_deg=from_deg, gust_mps=gust_mps, gust_period_s=period_s)
        if gust_mps == 0.0:
            self._gust = np.zeros(3)

    def tick(self) -> tuple[float, float, float]:
        """Return the air's velocity north, east, down in m/s for the next 20 ms."""
        wind = self.wind
        self._blew = not self._calm
        towards = math.radians(wind.from_deg + 180.0)
        if wind.gust_mps > 0.0:
            keep = 1.0 - TICK_S / max(TICK_S, wind.gust_period_s)
            size = wind.gust_mps * math.sqrt(1.0 - keep * keep)
            self._gust = keep * self._gust + size * self._draw() * (1.0, 1.0, 0.33)
        north, east = wind.mean_mps * math.cos(towards), wind.mean_mps * math.sin(towards)
        return north + float(self._gust[0]), east + float(self._gust[1]), float(self._gust[2])

    def _draw(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        if self._next >= len(self._draws):
            self._draws, self._next = self._rng.standard_normal((BLOCK, 3)), 0
        self._next += 1
        row: np.ndarray[tuple[int], np.dtype[np.float64]] = self._draws[self._next - 1]
        return row
