"""One checkout's part in a comparison: fly what is asked for on standard input, answer with processor seconds.

Run by `_flight_against.py` with the interpreter and the package of a checkout; the only argument is its folder of
measurements. A line in is a kind and an index, a line out the simulated and the processor seconds.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

KINEMATIC_TIMES = 10  # one is over too soon to be timed


def main() -> None:
    """Answer until the input ends."""
    sys.path.insert(0, sys.argv[1])
    import flight

    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # JSBSim's chatter must not stand among the answers
    boxes = flight.layouts(100)

    def kinematic(i: int) -> tuple[float, float]:
        flights = [flight.kinematic(boxes[i], i) for _ in range(KINEMATIC_TIMES)]
        return sum(simulated for simulated, _ in flights), 0.0

    kinds: dict[str, Callable[[int], tuple[float, float]]] = {
        "bare": lambda i: flight.bare(),
        "avoidance": lambda i: flight.fly(flight.mission_case("mission2", boxes[i], i)),
        "policy": lambda i: flight.fly(flight.policy_case(i)),
        "kinematic": kinematic,
    }
    for line in sys.stdin:
        kind, index = line.split()
        began = time.process_time()
        simulated, _ = kinds[kind](int(index))
        print(simulated, time.process_time() - began, file=answers)


if __name__ == "__main__":
    main()
