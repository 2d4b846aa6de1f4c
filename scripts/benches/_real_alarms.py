"""`scripts/bench rules --part real`: what the rules say of a real autopilot, flown by `policy-all` within ranges.

What such an autopilot does is no defect planted by anybody: each rule that is broken has to be looked into, and is the
rule's fault, the adapter's or a finding. So rows tell by rule how often it spoke and was broken, and no more: the seed
brings the test cases back, and what ends an autopilot is not for a public file (SECURITY.md).
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
from _inline import Flights, Inline

from saflite.campaign.presets.policy_campaigns import policy_campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import Flight, unpack_trace
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Setting, TestCase, identity
from saflite.contract.work import FlyResult, FlyWork, Result, Work
from saflite.oracle.judge import judge
from saflite.simulator_worker.registry import load_target

REFUSED = "refused"
TO_LOOK_AT = ("autopilot_died", "wedged")


class Judged(Flights):
    """Flies each test case once, judges it by all rules of the campaign, and gives the same flight to confirm it."""

    def __init__(self, policies: tuple[str, ...], keep: Path | None) -> None:
        super().__init__()
        self._policies, self._keep = policies, keep
        self.spoke: Counter[str] = Counter()
        self.broken: Counter[str] = Counter()
        self.endings: Counter[str] = Counter()

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Fly the test case of the lease, or hand out what it did before."""
        assert isinstance(work, FlyWork)
        name = identity(work.test_case)
        if (name, 0) not in self._kept:
            self._kept[name, 0] = self._first(work, cancelled)
        flight, packed = self._kept[name, 0]
        trace = self.blobs.put(packed) if packed else None
        told = msgspec.structs.replace(flight, test_case=name, flight_index=work.flight_index, trace=trace)
        return FlyResult(flight=told)

    def _first(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        try:
            flight, packed = self._fly(work, cancelled)
        except (Refused, Unavailable) as error:
            sys.stderr.write(f"{error}\n")
            refused = isinstance(error, Refused)
            flight, packed = Flight(test_case="", flight_index=0, ending="infra", worker="inline"), b""
            self.endings[REFUSED if refused else "infra"] += 1
            return flight, packed
        self.endings[flight.ending] += 1
        broken = bool(packed) and self._broken(work.test_case, flight, packed)
        if flight.ending in TO_LOOK_AT:
            sys.stderr.write(f"flight {self.flown} {flight.ending}: {flight.message}\n")
        if self._keep is not None and (broken or flight.ending in TO_LOOK_AT):
            (self._keep / f"flight-{self.flown}.json").write_bytes(msgspec.json.encode(work.test_case))
        return flight, packed

    def _broken(self, case: TestCase, flight: Flight, packed: bytes) -> bool:
        before = self.broken.total()
        for verdict in judge(case, flight, unpack_trace(packed), self._policies).verdicts:
            self.spoke[verdict.policy] += verdict.outcome in ("held", "violated")
            if verdict.outcome == "violated":
                self.broken[verdict.policy] += 1
                sys.stderr.write(f"flight {self.flown} {verdict.message}\n")
        return self.broken.total() > before


def said_of(target: str, flights: int, rng_seed: int, keep: Path | None = None) -> dict[str, Any]:
    """Return what the rules said of so many flights of `policy-all` on a target.

    Test cases in which a rule was broken, or that hung or died, are put into the folder `keep`.

    Raises:
        Unavailable: no binary of it is named here.
    """
    info = load_target(target).describe()
    if info.missing:
        raise Unavailable(info.missing)
    base = policy_campaign("policy-all", info)
    assert base is not None
    settings: dict[str, Setting] = {"log": "none"} if "log" in info.settings else {}
    campaign = msgspec.structs.replace(
        base,
        target=msgspec.structs.replace(base.target, settings=settings),
        budget_flights=flights,
        rng_seed=rng_seed,
        record="none",
        search=msgspec.structs.replace(base.search, shrink=False, confirm_flights=1, confirm_needed=1),
    )
    if keep is not None:
        keep.mkdir(parents=True, exist_ok=True)
    flyer = Judged(campaign.policies, keep)
    with tempfile.TemporaryDirectory(prefix="saflite-rules-") as folder:
        inline = Inline(campaign, Path(folder) / "run", flyer, info)
        inline.run(lambda status: status.flights >= flights)
        inline.close()
    return {
        "part": "real",
        "campaign": target,
        "autopilot": info.autopilot,
        "build": info.build,
        "rng_seed": rng_seed,
        "rules": len(campaign.policies),
        "flights": sum(flyer.endings.values()),
        "endings": dict(sorted(flyer.endings.items())),
        "spoke": {name: count for name, count in sorted(flyer.spoke.items()) if count},
        "broken": dict(flyer.broken.most_common()),
    }
