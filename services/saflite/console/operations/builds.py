"""Builds to compare, as the command line names them, and flights on them.

A build is `TARGET[+DEFECT...] [SETTING=VALUE ...]` in one argument; TARGET is a name, or the module file (.py) of one,
so that two versions of one module can stand side by side. Settings not named are the target's defaults.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from saflite.console.io.target_options import with_settings
from saflite.console.operations import judging
from saflite.contract import modules
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import AUTOPILOT_ALIVE, FLOWN_ENDINGS
from saflite.contract.memory_faults import is_memory_fault
from saflite.contract.test_case import Target, TestCase
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import PolicyTexts
from saflite.simulator_worker.registry import describe_target

FRESH_NOISE = 10_000
"""The first noise that no campaign flies: it keeps what violated under those below, and flights repeat bit by bit."""

TRIES = 2
"""How often a flight that says nothing of the vehicle is tried."""


class Build(NamedTuple):
    """What flies. `module` is the file of a target from outside; `digest` names the code that shapes its traces.

    `trouble` says why it cannot fly here, if that is known.
    """

    label: str
    target: Target
    module: Path | None
    digest: str
    trouble: str = ""

    @property
    def files(self) -> tuple[Path, ...]:
        """The module files it needs."""
        return () if self.module is None else (self.module,)

    def carrying(self, case: TestCase) -> TestCase:
        """Return the test case with this build in place of its own target; parameters are inputs and stay."""
        target = msgspec.structs.replace(self.target, parameters=case.target.parameters)
        return msgspec.structs.replace(case, target=target)


def parse(text: str) -> Build:
    """Return the build in one argument; raises Refused for targets, defects and settings there are not."""
    words = text.split()
    if not words:
        raise Refused("build", expected="TARGET[+DEFECT...] [SETTING=VALUE ...]", got=repr(text))
    head, *defects = words[0].split("+")
    module = Path(head) if head.endswith(".py") else None
    if module is not None:
        modules.use([module])
    name = head if module is None else module.stem
    info = describe_target(name)
    target = with_settings(Target(name=name), info, words[1:], defects)
    return Build(text, target, module, info.build, info.missing)


def use(build: Build) -> None:
    """Let this process find the target of a build; raises Unavailable where it cannot fly here."""
    modules.use(build.files)
    if build.trouble:
        raise Unavailable(f"build {build.label} cannot fly here: {build.trouble}")


def parse_or_leave(text: str) -> Build:
    """Return the build in one argument, one with its `trouble` where its file does not run or cannot tell here.

    Raises Refused for what was not meant: no such file, target, defect or setting.
    """
    head = (text.split() or [""])[0].split("+")[0]
    try:
        return parse(text)
    except Unavailable as fault:
        trouble = str(fault)
    except Refused as fault:
        if not (head.endswith(".py") and Path(head).is_file()):
            raise
        trouble = str(fault)
    return Build(text, Target(name=Path(head).stem), None, "", trouble)


def of_case(case: TestCase, settings: Sequence[str] = (), defects: Sequence[str] = ()) -> Build:
    """Return the build of a test case's own target as it is here, with settings changed."""
    info = describe_target(case.target.name)
    target = msgspec.structs.replace(case.target, build="")
    if settings or defects:
        target = with_settings(target, info, settings, defects)
    return Build(target.name, target, None, info.build, info.missing)


class Sample(NamedTuple):
    """One flight, judged. `verdicts` None: it says nothing of the vehicle (`message` why)."""

    noise: int
    ending: str
    verdicts: tuple[Verdict, ...] | None
    trace_digest: str = ""
    message: str = ""
    judgement: Judgement | None = None

    def of(self, policy: str) -> Verdict | None:
        """Return the verdict by a policy that could be judged: held, violated or vacuous."""
        for verdict in self.verdicts or ():
            if verdict.policy == policy and verdict.outcome != "inconclusive":
                return verdict
        flown = self.verdicts is not None and policy == AUTOPILOT_ALIVE
        return Verdict(policy=policy, outcome="held") if flown else None  # no such verdict: it did not die

    @property
    def memory_safety(self) -> bool:
        """Whether the autopilot died of what may be misused."""
        died = [one for one in self.verdicts or () if one.policy == AUTOPILOT_ALIVE]
        return any(is_memory_fault("autopilot_died", one.message) for one in died)

    @property
    def violated(self) -> tuple[str, ...]:
        """The policies it violated."""
        return tuple(one.policy for one in self.verdicts or () if one.outcome == "violated")


class Bench:
    """A simulator that flies test cases on one build; close it, or use it in a `with`."""

    def __init__(self, build: Build, wall_limit_s: float) -> None:
        modules.use(build.files)
        self.build, self._wall_limit_s = build, wall_limit_s
        self._simulator = None if build.trouble else judging.OwnSimulator()

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the simulator."""
        if self._simulator is not None:
            self._simulator.close()

    def fly(self, case: TestCase, policies: Sequence[str], texts: PolicyTexts, noise: int) -> Sample:
        """Fly the test case once under a noise; a build that cannot fly it, or no simulator, gives an empty sample."""
        if self._simulator is None:
            return Sample(noise, "infra", None, message=self.build.trouble)
        flown, sample = self.build.carrying(case), Sample(noise, "infra", None)
        judged = tuple(name for name in policies if name != AUTOPILOT_ALIVE)
        for _ in range(TRIES):
            try:
                made = self._simulator.fly(flown, self._wall_limit_s, noise, noise)
            except Refused as fault:
                return Sample(noise, "infra", None, message=str(fault))
            except Unavailable as fault:
                sample = Sample(noise, "infra", None, message=str(fault))
                continue
            flight = made.flight
            if flight.ending in FLOWN_ENDINGS:
                judgement = judging.judge(flown, made, judged, texts)
                return Sample(noise, flight.ending, judgement.verdicts, flight.trace_digest, judgement=judgement)
            sample = Sample(noise, flight.ending, None, message=flight.message)
        return sample


class Benches:
    """The bench of one build after another; close it, or use it in a `with`.

    One at a time is open: a sandbox takes the simulator of a younger one for something its flight left behind.
    """

    def __init__(self, wall_limit_s: float) -> None:
        self._wall_limit_s, self._open = wall_limit_s, list[Bench]()

    def __enter__(self) -> Benches:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def of(self, build: Build) -> Bench:
        """Return the bench of a build; that of another build is closed."""
        if not self._open or self._open[0].build != build:
            self.close()
            self._open = [Bench(build, self._wall_limit_s)]
        return self._open[0]

    def close(self) -> None:
        """End the simulator that is open."""
        for bench in self._open:
            bench.close()
        self._open = []


def fresh_noises(count: int) -> tuple[int, ...]:
    """Return the noises of `count` flights that are counted: none had a part in what was found, or confirmed it."""
    return tuple(range(FRESH_NOISE, FRESH_NOISE + count))


def noises(count: int, first: int = 0) -> tuple[int, ...]:
    """Return the noises of `count` flights: the one of the record first, then fresh ones."""
    return (first, *fresh_noises(count - 1))
