"""A run that others made puts no markup of theirs into a page: wherever its store can hold a text, one is put there."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pytest

from saflite.campaign.storage.projections import TABLES
from saflite.campaign.storage.store import Store
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.dashboard import pages
from saflite.console.view.dashboard.source import _PARTS, EndpointSource, RunSource
from saflite.console.view.html_text import escape
from saflite.console.view.report import data, evidence, page
from saflite.contract import wire
from saflite.contract.control import Answer, Verb
from saflite.contract.errors import FarmError, Refused
from saflite.contract.verdict import Transition
from saflite.contract.work import JudgeResult, MutateResult, Result, Work

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

TAG = "<b onclick='evil()'>\""
ORIGIN = ("strategy", "arm", "parent", "note")
S = TypeVar("S", bound=msgspec.Struct)
COLUMNS = [
    (table, column.split()[0])
    for table, columns in TABLES.items()
    for column in columns
    if not column.startswith("PRIMARY KEY") and column.split()[1] == "TEXT"
]


def hostile(plain: Any, kind: Any, told: list[str]) -> Any:
    """Return plain data with markup for every text that may be any text where it stands; `told` gets their paths."""

    def walk(inside: Any, path: str) -> None:
        for key, one in inside.items() if isinstance(inside, dict) else enumerate(inside):
            place = f"{path}.{key}" if isinstance(inside, dict) else path
            if isinstance(one, (dict, list)):
                walk(one, place)
            if not isinstance(one, str):
                continue
            inside[key] = TAG
            try:
                wire.convert(plain, kind)
                told.append(place)
            except (msgspec.ValidationError, Refused):
                inside[key] = one

    walk(plain, kind.__name__)
    return plain


def said(message: S, told: list[str]) -> S:
    """Return a message that says markup wherever it may say anything."""
    kind = type(message)
    return wire.convert(hostile(wire.unpack(wire.encode(message), Any), kind, told), kind)


class TellsMarkup(doubles.Service):
    """A farm whose workers say markup wherever they may say anything."""

    def __init__(self, store: Store, told: list[str]) -> None:
        super().__init__(store.blobs)
        self._told = told

    def do(self, work: Work) -> Result:
        """Say it."""
        result = super().do(work)
        if isinstance(result, MutateResult):
            cases = [
                msgspec.structs.replace(one, origin=msgspec.structs.replace(one.origin, **dict.fromkeys(ORIGIN, TAG)))
                for one in result.test_cases
            ]
            return msgspec.structs.replace(result, test_cases=tuple(cases))
        if isinstance(result, JudgeResult):
            seen = msgspec.structs.replace(result.judgement, transitions=(Transition("GUIDED", "GUIDED"),))
            result = JudgeResult(judgement=seen)
        return said(result, self._told)


SAID = {
    "FlyResult.flight.message",
    "JudgeResult.judgement.verdicts.behaviour",
    "JudgeResult.judgement.verdicts.message",
    "ScoreResult.scores.fault",
    "ScoreResult.scores.reason",
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A run as ours are, and one whose workers say markup."""
    made, told = {}, list[str]()
    for name in ("ours", "theirs"):
        made[name] = tmp_path_factory.mktemp(name) / "run"
        store = Store.create(made[name], doubles.campaign(8), doubles.TEMPLATE, doubles.TARGET)
        driver = Driver(store.rebuild(), store)
        if name == "theirs":
            driver.service = TellsMarkup(store, told)
        driver.run()
        store.close()
    assert set(told) >= SAID
    return made


def views(run_dir: Path) -> Iterator[tuple[str, str]]:
    """Yield each page and part of a page that can be made of a run, with its name."""
    source = RunSource(run_dir)
    makers: dict[str, Callable[[], str]] = {
        "run": partial(pages.of_run, 0, source, "operator", alone=False),
        "runs": partial(pages.of_all, [source, source], "operator"),
        "report": partial(_report, run_dir),
        **{name: partial(source.part, name) for name in _PARTS},
    }
    with suppress(FarmError), open_run(run_dir) as run:
        for one in run.violations():
            makers[f"find {one.test_case}"] = partial(source.find, one.test_case, public=False)
    for name, make in makers.items():
        try:
            yield name, make()
        except FarmError:  # damage is told as such
            continue


def _report(run_dir: Path) -> str:
    with open_run(run_dir) as run:
        return page.render(data.read(run), "run")


def _change(run_dir: Path, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as store:
        assert store.execute(statement, values).rowcount > 0, "nothing to change"
        store.commit()


@pytest.mark.parametrize(("table", "column"), COLUMNS)
def test_no_column_of_a_store_puts_markup_into_a_page(
    table: str, column: str, runs: dict[str, Path], tmp_path: Path
) -> None:
    shutil.copytree(runs["ours"], tmp_path / "run")
    _change(tmp_path / "run", f"UPDATE {table} SET {column} = ? || coalesce({column}, '')", TAG)
    for name, html in views(tmp_path / "run"):
        assert TAG not in html, name


def test_nothing_that_workers_say_puts_markup_into_a_page(runs: dict[str, Path]) -> None:
    shown = dict(views(runs["theirs"]))
    assert {"run", "runs", "report", *_PARTS} < set(shown)
    assert not [name for name, html in shown.items() if TAG in html]
    assert escape(TAG) in shown["report"]
    assert all(escape(TAG) in html for name, html in shown.items() if name.startswith("find"))


def test_nothing_that_a_run_says_of_itself_puts_markup_into_a_page(runs: dict[str, Path], tmp_path: Path) -> None:
    shutil.copytree(runs["theirs"], tmp_path / "run")
    told: list[str] = []
    with open_run(tmp_path / "run") as run:
        target = msgspec.structs.replace(run.target, modes={TAG: 4}, missing="words", options="words")
        campaign = msgspec.structs.replace(run.campaign, description="words")
    for key, message in (("campaign", said(campaign, told)), ("target", said(target, told))):
        _change(tmp_path / "run", "UPDATE meta SET value = ? WHERE key = ?", wire.encode(message), key)
    assert {"Campaign.description", "TargetInfo.build"} <= set(told)  # a target's name is one: no markup fits in
    shown = dict(views(tmp_path / "run"))
    assert {"run", "runs", "report", "coverage"} < set(shown)
    assert not [name for name, html in shown.items() if TAG in html]
    assert all(escape(TAG) in shown[name] for name in ("run", "runs", "report", "coverage"))


def test_nothing_that_a_farm_elsewhere_says_puts_markup_into_a_page(
    runs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Elsewhere:
        """A farm at an endpoint that tells all events of a run."""

        def order(self, verb: Verb, text: str, number: int, *, within_s: float) -> Answer:
            with open_run(runs["theirs"]) as run:
                return Answer(accepted=True, events=tuple(map(wire.encode, islice(run.events(number), 100))))

    monkeypatch.setattr(farm_lookup, "connect", lambda where: Elsewhere())
    source = EndpointSource(farm_lookup.Where(None, f"tls/{TAG}:7447", TAG))
    found = source.violations(public=False)
    assert any(TAG in one.message for one in found)
    shown = [pages.finds(found), *(source.find(one.test_case, public=False) for one in found)]
    assert not [html for html in shown if TAG in html]
    assert all(escape(TAG) in html for html in shown)


def test_evidence_escapes_what_a_row_of_flights_holds_whoever_read_it(runs: dict[str, Path]) -> None:
    words: Any = TAG
    with open_run(runs["ours"]) as run:
        exhibit = data.read(run).exhibits[0]
    rows = tuple(row._replace(ending=words, trace_digest=words, worker=words) for row in exhibit.flights)
    html = evidence.section(1, exhibit._replace(flights=rows, recording=words), words)
    assert TAG not in html
    assert escape(f"{TAG}, ") in html


@pytest.mark.parametrize("value", ["no such word", b"\xff", None])
@pytest.mark.parametrize("column", ["purpose", "ending", "simulated_s", "wall_s", "flight_index"])
def test_a_flight_of_which_the_tables_say_what_no_flight_is_is_refused(
    column: str, value: object, runs: dict[str, Path], tmp_path: Path
) -> None:
    shutil.copytree(runs["ours"], tmp_path / "run")
    _change(tmp_path / "run", f"UPDATE flights SET {column} = ? WHERE rowid = (SELECT min(rowid) FROM flights)", value)
    with open_run(tmp_path / "run") as run, pytest.raises(Refused, match="books"):
        run.flights()
