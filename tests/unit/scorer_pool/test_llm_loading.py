"""A model that is still loading: nobody who waits for it, or waits no more, is left with noise or hanging."""

from __future__ import annotations

import asyncio
import gc
from concurrent.futures import wait

import pytest

from saflite.contract.errors import Unavailable

from .test_llm import good, job, model


def test_a_load_that_fails_when_nobody_waits_for_it_is_no_noise(caplog: pytest.LogCaptureFixture) -> None:
    scorer, chat = model(good)
    chat.load_fault, chat.load_wait = Unavailable("RemoteProtocolError: disconnected"), asyncio.Event()
    assert {score.fault for score in scorer.score(job(deadline_s=0.05)).scores} == {"loading"}
    scorer._background._running().call_soon_threadsafe(chat.load_wait.set)
    assert scorer._loading is not None
    wait([scorer._loading])
    assert {score.fault for score in scorer.score(job()).scores} == {"unreachable"}, "it is tried again"
    scorer.close()
    gc.collect()
    assert caplog.text == ""


def test_closing_ends_what_is_being_asked(caplog: pytest.LogCaptureFixture, recwarn: pytest.WarningsRecorder) -> None:
    scorer, chat = model(None)
    chat.load_wait = asyncio.Event()
    assert {score.fault for score in scorer.score(job(deadline_s=0.05)).scores} == {"loading"}
    assert scorer._loading is not None
    scorer.close()
    assert scorer._loading.cancelled()
    del scorer, chat
    gc.collect()
    assert caplog.text == ""
    assert not list(recwarn)
