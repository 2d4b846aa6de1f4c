"""Finds scorer models by their place: one file each in `scorer_pool/models`, or an entry point `saflite.scorers`."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.metadata import entry_points
from numbers import Real
from types import ModuleType
from typing import cast

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.modules import given, load_file
from saflite.contract.names import is_label
from saflite.contract.outside_code import Raised, of_outside
from saflite.contract.score import Usage
from saflite.contract.service import Cancelled
from saflite.scorer_pool import models
from saflite.scorer_pool.labels import split_label
from saflite.scorer_pool.model import Job, Model, ModelScore, ScoreSheet, Tools

ENTRY_POINT_GROUP = "saflite.scorers"


@cache
def _outside() -> dict[str, str]:
    return {point.name: point.value for point in entry_points(group=ENTRY_POINT_GROUP)}


def model_names() -> tuple[str, ...]:
    """Return the kinds of models there are, sorted."""
    return tuple(sorted(_placed() | set(_outside()) | set(given("scorer"))))


def describe(kind: str) -> str:
    """Return the text a model kind is listed with: the docstring of its file."""
    return inspect.getdoc(_module(kind)) or ""


def make(label: str, tools: Tools) -> Model:
    """Return the model a label names; raises Refused for an unknown kind or a bad argument."""
    kind, argument = split_label(label)
    factory = getattr(_module(kind), "Model", None)
    if factory is None:
        raise Refused("scorer model", expected=f"a class Model in the file of {kind!r}", got="none")
    if kind in _placed():
        return cast(Model, factory(argument, tools))
    with of_outside("scorer", kind):
        return _FromOutside(kind, factory(argument, tools))


class _FromOutside:
    """A model from outside: what it raises, or returns instead of a sheet, is its own fault and ends no process."""

    def __init__(self, kind: str, model: Model) -> None:
        self._kind, self._model = kind, model
        self.label: str = getattr(model, "label", kind)
        self.parallel: int = getattr(model, "parallel", 1)
        self.waits = bool(getattr(model, "waits", False))

    def score(self, job: Job) -> ScoreSheet:
        """Return its sheet; raises Raised beside what a model may raise, also where a field of the sheet is no such."""
        with of_outside("scorer", self._kind):
            sheet = self._model.score(job)
            odd = next(_odd_fields(sheet), "")
            if not odd:
                return sheet._replace(scores=tuple(one._replace(value=float(one.value)) for one in sheet.scores))
        what = f"scorer {self._kind} returned no ScoreSheet of the right types: {odd}"
        raise Raised(what, what)

    def warm(self, cancelled: Cancelled) -> str:
        """Load it; raises Raised beside what a model may raise."""
        with of_outside("scorer", self._kind):
            return str(self._model.warm(cancelled))

    def close(self) -> None:
        """Free what it holds; raises Raised."""
        with of_outside("scorer", self._kind):
            self._model.close()


def _odd_fields(sheet: object) -> Iterator[str]:
    """Yield in words each field of a sheet that nobody could pass on: where, what is expected, what it is."""
    if not isinstance(sheet, ScoreSheet):
        yield _odd("score()", "a ScoreSheet", sheet)
        return
    yield from _not_of(sheet, "", digest=(str, "a text"), scores=(Sequence, "a tuple of ModelScores"))
    try:
        wire.checked(sheet.usage, Usage)
    except Refused as fault:
        yield f"usage: {fault}"
    scores: object = sheet.scores
    for place, score in enumerate(scores if isinstance(scores, Sequence) else ()):
        where = f"scores[{place}]"
        if not isinstance(score, ModelScore):
            yield _odd(where, "a ModelScore", score)
            continue
        texts = dict.fromkeys(("reason", "fault", "scored_by", "prompt_digest", "kind"), (str, "a text"))
        yield from _not_of(score, f"{where}.", value=(Real, "a number"), **texts)
        if score.scored_by and not is_label(f"{score.scored_by}"):
            yield f"{where}.scored_by: expected the name of a model, got {score.scored_by[:80]!r}"


def _not_of(owner: object, where: str, **fields: tuple[type, str]) -> Iterator[str]:
    """Yield in words each field that is not of its type."""
    for name, (kind, expected) in fields.items():
        if not isinstance(getattr(owner, name), kind):
            yield _odd(f"{where}{name}", expected, getattr(owner, name))


def _odd(where: str, expected: str, got: object) -> str:
    return f"{where}: expected {expected}, got {'None' if got is None else type(got).__name__}"


def check_label(label: str) -> None:
    """Raise Refused unless a model can be made of `label`; says nothing about whether its server can be reached."""

    def part(other: str) -> Model:
        return make(other, Tools(_NoClock(), part))

    part(label).close()


class _NoClock:
    """Stands in where a model is made but never asked."""

    def monotonic_s(self) -> float:
        """Return 0."""
        return 0.0

    def unix_s(self) -> float:
        """Return 0."""
        return 0.0


def _check_kind(kind: str) -> None:
    if kind not in model_names():
        raise Refused(
            "scorer model",
            expected=f"one of {', '.join(model_names())}",
            got=repr(kind),
            fix="see `saflite list scorers`; one of your own is a file that the farm is started with (--module FILE)",
        )


def _module(kind: str) -> ModuleType:
    _check_kind(kind)
    if kind in given("scorer"):
        path = given("scorer")[kind].path
        if kind in _placed():
            raise Refused("module", where=str(path), expected="a name no scorer model of ours has", got=repr(kind))
        return load_file(path)
    return importlib.import_module(_outside().get(kind, f"{models.__name__}.{kind}").partition(":")[0])


def _placed() -> set[str]:
    return {info.name for info in pkgutil.iter_modules(models.__path__)}
