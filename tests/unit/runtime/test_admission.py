"""Who may join: every mismatch is refused in one line that names what differs and what to do."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from saflite.contract.config import Needs
from saflite.contract.join import Join
from saflite.contract.modules import Kind, Outside
from saflite.contract.test_case import Target
from saflite.contract.topics import PROTOCOL, STAGES
from saflite.contract.work import Stage, TargetBuild
from saflite.runtime.admission import DECIDES, Terms, objection
from saflite.runtime.software import software_of

OURS = {stage: f"{stage}-code" for stage in STAGES}
TERMS = Terms(Target(name="reference", build="b1"), "1.0", OURS.__getitem__, ("gpu-*",))


def _card(stage: Stage = "fly", /, **other: Any) -> Join:
    card = Join(
        protocol=PROTOCOL,
        worker="w",
        session="s",
        stage=stage,
        version="1.0",
        software=OURS[stage],
        targets=(TargetBuild("reference", "b1"),),
    )
    return msgspec.structs.replace(card, **other)


@pytest.mark.parametrize("stage", STAGES)
def test_what_fits_may_join(stage: Stage) -> None:
    assert objection(_card(stage), TERMS) == ""


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (
            {"protocol": PROTOCOL + 1, "version": "2.0"},
            ("protocol", str(PROTOCOL), str(PROTOCOL + 1), "2.0", "install"),
        ),
        ({"worker": ""}, ("worker name",)),
        ({"worker": "../books"}, ("worker name",)),
        ({"worker": "a/b"}, ("worker name",)),
        ({"worker": "a*"}, ("worker name",)),
        ({"worker": "x" * 65}, ("worker name",)),
        ({"worker": "."}, ("worker name",)),
        ({"worker": "w\n"}, ("worker name",)),
        ({"session": ""}, ("name",)),
        ({"labels": {"x": "\x01" * 1_024, "y": "\x01" * 1_024}}, ("of itself", "8192 bytes", "labels")),
        ({"targets": tuple(TargetBuild(f"t{n}", "b" * 64) for n in range(256))}, ("of itself", "8192 bytes")),
        ({"software": "other-code-1234", "version": "0.9"}, ("software of fly", "fly-code", "other-code-1", "0.9")),
        ({"targets": ()}, ("targets", "reference", "nothing")),
        ({"targets": (TargetBuild("px4", "b1"),)}, ("targets", "reference", "px4")),
        ({"targets": (TargetBuild("reference", "b2"),)}, ("build of reference", "b1", "b2", "start another run")),
    ],
    ids=str,
)
def test_each_mismatch_is_told_in_one_line(other: dict[str, Any], named: tuple[str, ...]) -> None:
    words = objection(_card(**other), TERMS)
    assert all(name in words for name in named), words
    assert "\n" not in words
    assert len(words) < 400


@pytest.mark.parametrize("stage", ["fly", "judge", "mutate", "score"])
def test_where_software_decides_results_it_must_be_the_same(stage: Stage) -> None:
    assert f"software of {stage}" in objection(_card(stage, software="other"), TERMS)


def test_recorders_and_scorers_that_are_named_may_run_other_software() -> None:
    assert objection(_card("record", software="other"), TERMS) == ""
    assert objection(_card("score", worker="gpu-1", software="other"), TERMS) == ""
    assert "scorer.guests" in objection(_card("score", worker="cpu-1", software="other"), TERMS)
    assert objection(_card("judge", worker="gpu-1", software="other"), TERMS)


def test_a_campaign_that_names_no_build_takes_any() -> None:
    any_build = TERMS._replace(target=Target(name="reference"))
    assert objection(_card(targets=(TargetBuild("reference", "b2"),)), any_build) == ""


def test_what_a_stranger_says_is_shown_short_and_harmless() -> None:
    words = objection(_card(software="\x1b[31m\n" + "x" * 10_000, version="\x1b\n" * 5_000), TERMS)
    assert words.isprintable()
    assert len(words) < 400


def test_each_stage_has_a_digest_of_its_own_that_stays() -> None:
    digests = {stage: software_of(stage) for stage in STAGES}
    assert len(set(digests.values())) == len(STAGES)
    software_of.cache_clear()
    assert {stage: software_of(stage) for stage in STAGES} == digests


def test_modules_that_decide_what_a_stage_answers_must_be_the_same() -> None:
    kinds: tuple[Kind, ...] = ("strategy", "scorer", "target", "policy")
    own = tuple(Outside(kind=kind, name="own", file=f"/here/own_{kind}.py", digest="a" * 64) for kind in kinds)
    terms = TERMS._replace(modules=own)
    mine = {module.key: module.digest for module in own}
    for stage, kind in DECIDES.items():
        assert objection(_card(stage, modules=mine), terms) == ""
        words = objection(_card(stage, modules=mine | {f"{kind} own": "e" * 64}), terms)
        assert f"module {kind} own: expected" in words
        assert "eeee" in words
        assert f"own_{kind}.py" in objection(_card(stage), terms)
        assert "\n" not in words
    assert objection(_card("judge"), terms) == objection(_card("record"), terms) == ""
    assert objection(_card("score", worker="gpu-1"), terms) == ""


@pytest.mark.parametrize(
    ("needs", "said", "words"),
    [
        (Needs(cores=4), {"cores": 4}, ""),
        (Needs(cores=4), {"cores": 3}, "cores for fly: expected at least 4, got 3"),
        (Needs(gpus=1), {"gpus": 1}, ""),
        (Needs(gpus=1), {}, "gpus for fly: expected at least 1, got 0"),
        (Needs(labels={"site": "lab*"}), {"labels": {"site": "lab-2"}}, ""),
        (Needs(labels={"site": "lab*"}), {"labels": {"site": "home"}}, "label site for fly: expected lab*, got home"),
        (Needs(labels={"site": "*"}), {}, "label site for fly: expected *, got nothing"),
    ],
)
def test_a_worker_has_what_its_work_needs(needs: Needs, said: dict[str, object], words: str) -> None:
    terms = TERMS._replace(needs={"fly": needs})
    card = msgspec.structs.replace(_card("fly"), **said)
    assert objection(card, terms).startswith(words)
    assert bool(objection(card, terms)) == bool(words)
    assert objection(_card("judge"), terms) == ""
