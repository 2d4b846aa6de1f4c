"""The only place where randomness is made.

A draw depends on *what* it is for, never on which worker makes it or when:
`derive(campaign_rng_seed, "mutate", round)` is the same stream on every machine.
"""

from __future__ import annotations

import hashlib

import numpy as np

Label = str | int


def derive_seed(rng_seed: int, *what: Label) -> int:
    """Return a 63-bit number that depends on `rng_seed` and every label in `what`."""
    text = "\x1f".join([str(rng_seed), *(f"{type(label).__name__}:{label}" for label in what)])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def derive(rng_seed: int, *what: Label) -> np.random.Generator:
    """Return a random generator of its own for the purpose `what` (PCG64, stable over platforms)."""
    return np.random.Generator(np.random.PCG64(derive_seed(rng_seed, *what)))
