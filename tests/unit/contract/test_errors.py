"""What was refused in one process can be told by another."""

from __future__ import annotations

import pickle

from saflite.contract.errors import Refused, RefusedElsewhere


def test_a_refusal_goes_from_a_pool_of_processes_to_who_asked() -> None:
    refused = Refused("strategy", expected="one of a, b", got="'c'", where="arm", fix="see `saflite list strategies`")
    again = pickle.loads(pickle.dumps(refused))
    assert (type(again), str(again), again.where, again.fix) == (Refused, str(refused), "arm", refused.fix)
    elsewhere = pickle.loads(pickle.dumps(RefusedElsewhere("worker", "no such build")))
    assert (type(elsewhere), str(elsewhere), elsewhere.what) == (RefusedElsewhere, "no such build", "worker")
