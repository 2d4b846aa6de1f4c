"""Which hits end a flight: those of a vehicle whose attitude was lost just before, and that does not fly on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FALLS_S = 5.0  # from the loss of the attitude to the ground: from 120 m
LIES_S = 30.0  # until somebody, or the autopilot, stops the motors of what lies there


def struck(
    hits_s: NDArray[np.float64], lost_s: NDArray[np.float64], stopped_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the hits that end a flight, in order.

    Args:
        hits_s: when something was hit with the motors armed (s), in order; shape (n,).
        lost_s: moments at which the attitude was lost with the motors armed (s), in order; shape (m,).
        stopped_s: moments at which the motors were off, and the end of the log (s), in order; shape (k,).
    """
    before = np.append(-np.inf, lost_s)[np.searchsorted(lost_s, hits_s, side="right")]
    after = np.append(stopped_s, -np.inf)[np.searchsorted(stopped_s, hits_s)]
    ends: NDArray[np.float64] = hits_s[(hits_s - before <= FALLS_S) & (after - hits_s <= LIES_S)]
    return ends
