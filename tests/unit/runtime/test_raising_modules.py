"""Code from outside that raises is told by name, file and line; nothing of the farm ends with it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.conformance.kit import Check, findings
from saflite.console.cli import main
from saflite.console.operations import judging
from saflite.contract import modules
from saflite.contract.clock import Clock
from saflite.contract.flight import Flight
from saflite.contract.outside_code import Raised
from saflite.contract.score import EMBEDDED
from saflite.contract.test_case import Scenario, Target, TestCase
from saflite.contract.work import MutateWork, ScoreResult, ScoreWork, WarmResult, WarmWork
from saflite.mutator.work import Mutator
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.model import PolicyBrief
from saflite.scorer_pool.work import ScorerPool
from saflite.simulator_worker.registry import describe_target

TEMPLATES = Path(judging.__file__).parents[1] / "templates"
CLOCK: Clock = WallClock()


PANIC = "raise type('PanicException', (BaseException,), {})('index out of bounds')"  # as packages in Rust do
NAMES = ("KeyboardInterrupt", "SystemExit")
BEYOND = ((PANIC, "PanicException"), *((f"raise {name}", name) for name in NAMES))
"""What is raised that is no Exception, and its name; nobody pressed Ctrl-C."""


def broken(tmp_path: Path, kind: str, after: str, what: str = "1 / 0", name: str = "ZeroDivisionError") -> str:
    """Hand in the template of a kind with a statement after a line; return what it raises and where, as it is told."""
    lines = (TEMPLATES / f"{kind}.py").read_text(encoding="utf-8").replace("NAME", f"z{kind}").splitlines()
    place = next(number for number, line in enumerate(lines) if after in line) + 1
    while '"""' in lines[place] or not lines[place].strip():
        place += 1
    indent = lines[place][: len(lines[place]) - len(lines[place].lstrip())]
    lines[place:place] = [f"{indent}{line}" for line in what.splitlines()]
    (tmp_path / f"z{kind}.py").write_text("\n".join(lines), encoding="utf-8")
    modules.use([tmp_path / f"z{kind}.py"])
    return f"{kind} z{kind} raised {name} (z{kind}.py line {place + 1})"


@pytest.fixture(autouse=True)
def no_modules() -> Iterator[None]:
    yield
    modules.forget()


def batch(label: str, *shadows: str) -> ScoreWork:
    case = template(load_campaign("avoidance-m2"))
    return ScoreWork(round=0, model=label, shadow=shadows, policies=(), test_cases=(case,), rng_seed=1, deadline_s=5.0)


def score(pool: ScorerPool, work: ScoreWork) -> ScoreResult:
    result = pool.do(work, lambda: False)
    assert isinstance(result, ScoreResult)
    return result


@pytest.fixture
def pool() -> Iterator[ScorerPool]:
    pool = ScorerPool(lambda name, texts: PolicyBrief(name), CLOCK)
    yield pool
    pool.close()


def test_the_embedded_scorer_answers_for_one_that_raises(tmp_path: Path, pool: ScorerPool) -> None:
    where = broken(tmp_path, "scorer", "def _scored(")
    for _ in range(2):
        (deciding,) = score(pool, batch("zscorer")).scores
        assert (deciding.fault, deciding.scored_by) == (where, EMBEDDED)
    (beside,) = score(pool, batch(EMBEDDED, "zscorer")).scores
    assert (beside.model, beside.fault) == (EMBEDDED, "")


def test_one_that_returns_no_sheet_is_told_too(tmp_path: Path, pool: ScorerPool) -> None:
    text = (TEMPLATES / "scorer.py").read_text(encoding="utf-8")
    for name, instead in (("none", "None"), ("texts", 'ScoreSheet((ModelScore("high"),))')):
        path = tmp_path / f"{name}.py"
        path.write_text(text.replace("return ScoreSheet", f"return {instead}\n        return ScoreSheet"))
        modules.use([path])
        (deciding,) = score(pool, batch(name)).scores
        assert deciding.fault.startswith(f"scorer {name} returned no ScoreSheet")
        assert deciding.scored_by == EMBEDDED


@pytest.mark.parametrize(
    ("sheet", "odd"),
    [
        ("ModelScore(5.0, None)", "scores[0].reason: expected a text, got None"),
        ("ModelScore(5.0, 'x', None)", "scores[0].fault: expected a text, got None"),
        ("ModelScore(5.0, 'x', scored_by=7)", "scores[0].scored_by: expected a text, got int"),
        ("ModelScore(5.0, 'x', scored_by='a b')", "scores[0].scored_by: expected the name of a model, got 'a b'"),
        ("ModelScore(5.0, 'x', prompt_digest=b'')", "scores[0].prompt_digest: expected a text, got bytes"),
        ("ModelScore(5.0, 'x', kind=None)", "scores[0].kind: expected a text, got None"),
        ("ModelScore(None, 'x')", "scores[0].value: expected a number, got None"),
        ("None", "scores[0]: expected a ModelScore, got None"),
        ("ModelScore(5.0), digest=None", "digest: expected a text, got None"),
        ("ModelScore(5.0), usage=None", "usage: "),
        ("ModelScore(5.0), usage=Usage(calls='many')", "usage: "),
    ],
)
def test_a_field_of_a_wrong_type_is_told_by_name(
    tmp_path: Path, pool: ScorerPool, capsys: pytest.CaptureFixture[str], sheet: str, odd: str
) -> None:
    text = (TEMPLATES / "scorer.py").read_text(encoding="utf-8")
    text = text.replace("LABEL = ", "from saflite.contract.score import Usage\n\nLABEL = ")
    score_, _, rest = sheet.partition("), ")
    made = f"ScoreSheet(({score_}),), {rest})" if rest else f"ScoreSheet(({sheet},))"
    path = tmp_path / "odd.py"
    path.write_text(text.replace("return ScoreSheet", f"return {made}\n        return ScoreSheet"), encoding="utf-8")
    modules.use([path])
    (deciding,) = score(pool, batch("odd")).scores
    assert deciding.fault.startswith(f"scorer odd returned no ScoreSheet of the right types: {odd}")
    assert deciding.scored_by == EMBEDDED
    case = tmp_path / "case.json"
    case.write_bytes(msgspec.json.encode(template(load_campaign("avoidance-m2"))))
    assert main(["score", str(case), "--scorer", "odd", "--module", str(path)]) == 0
    assert "fault of saflite itself" not in capsys.readouterr().err


def test_one_that_cannot_be_warmed_is_not_ready(tmp_path: Path, pool: ScorerPool) -> None:
    where = broken(tmp_path, "scorer", "def warm(")
    warmed = pool.do(WarmWork(model="zscorer", load_deadline_s=5.0), lambda: False)
    assert isinstance(warmed, WarmResult)
    assert not warmed.ready
    assert where in warmed.message


def mutate_work() -> MutateWork:
    return MutateWork(
        round=0,
        strategy="zstrategy",
        settings={},
        template=template(load_campaign("policy-a-chute")),
        policies=("a-chute",),
        target=describe_target("reference"),
        count=1,
        rng_seed=1,
        from_cursor=-1,
        cursor=-1,
        outcomes=(),
    )


def test_a_strategy_that_raises_is_refused_by_name(tmp_path: Path) -> None:
    where = broken(tmp_path, "strategy", "def ask(")
    mutator = Mutator()
    for _ in range(2):  # it is made anew the second time
        with pytest.raises(Raised) as told:
            mutator.do(mutate_work(), lambda: False)
        assert told.value.what == where


@pytest.mark.parametrize(("what", "name"), BEYOND)
def test_what_is_no_exception_is_told_as_the_fault_of_who_raised_it(
    tmp_path: Path, pool: ScorerPool, what: str, name: str
) -> None:
    where = broken(tmp_path, "strategy", "def ask(", what, name)
    with pytest.raises(Raised) as told:
        Mutator().do(mutate_work(), lambda: False)
    assert told.value.what == where
    where = broken(tmp_path, "scorer", "def _scored(", what, name)
    (deciding,) = score(pool, batch("zscorer")).scores
    assert (deciding.fault, deciding.scored_by) == (where, EMBEDDED)
    where = broken(tmp_path, "target", "def fly(", what, name)
    flown = lost_flight()
    assert (flown.ending, flown.message.partition(": ")[0]) == ("lost", where)
    (found,) = findings([Check("outside", lambda: exec(what))])  # type: ignore[arg-type, return-value]
    assert found.text.startswith(name)


@pytest.mark.parametrize("what", ["1 / 0", PANIC, "raise KeyboardInterrupt"])
def test_ctrl_c_stops_whatever_code_from_outside_makes_of_it(tmp_path: Path, what: str) -> None:
    press = "import os, signal; os.kill(os.getpid(), signal.SIGINT)"
    broken(tmp_path, "strategy", "def ask(", f"try: {press}\nexcept BaseException: {what}")
    with pytest.raises(KeyboardInterrupt):
        Mutator().do(mutate_work(), lambda: False)
    path = tmp_path / "pressed.py"
    path.write_text(press, encoding="utf-8")
    with pytest.raises(KeyboardInterrupt):
        modules.use([path])
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def lost_flight() -> Flight:
    """Return the flight of a module `ztarget`."""
    starts = describe_target("ztarget").start_states
    scenario = Scenario(start=starts[0], time_limit_s=2.0)
    case = TestCase(target=Target(name="ztarget"), scenario=scenario)
    return judging.fly(case, 30.0).flight


def test_a_flight_lost_to_a_target_that_raises_says_where(tmp_path: Path) -> None:
    where = broken(tmp_path, "target", "def fly(")
    flown = lost_flight()
    assert (flown.ending, flown.message) == ("lost", f"{where}: division by zero")


def test_score_says_whose_fault_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = broken(tmp_path, "scorer", "def _scored(")
    case = tmp_path / "case.json"
    case.write_bytes(msgspec.json.encode(template(load_campaign("avoidance-m2"))))
    assert main(["score", str(case), "--scorer", "zscorer", "--module", str(tmp_path / "zscorer.py")]) == 0
    said = capsys.readouterr()
    assert f"[{where}]" in said.out
    assert "fault of saflite itself" not in said.err
