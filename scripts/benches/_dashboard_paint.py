"""First paint of the dashboard over a run of many flights, in headless Chromium driven as in the live tests."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx

from saflite.contract.errors import Unavailable

TESTS = Path(__file__).resolve().parents[2] / "tests"
FIRST_PAINT = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
BARE_PAGE = "data:text/html,<p>One line.</p>"
END_S = 20.0


def made(run_dir: Path, flights: int) -> Path:
    """Make a run of the books alone, with the flights of the simulated farm of the tests."""
    sys.path.insert(0, str(TESTS / "unit" / "console"))
    from dashboard_runs import make_run

    return make_run(run_dir, flights, checked=False)


@contextmanager
def _served(run_dir: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "saflite", "dashboard", str(run_dir), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None, "a pipe was asked for"
        yield process.stdout.readline().split()[1].rstrip("/")
    finally:
        process.terminate()
        process.wait(END_S)


def paint(run_dir: Path, rounds: int) -> dict[str, float]:
    """Return medians over loads of a page of a run after one that is not counted: server's answer, first
    paint, and beside it that of a page of one line.

    Raises:
        Unavailable: there is no Chromium here.
    """
    sys.path.insert(0, str(TESTS / "live"))
    import browser

    if browser.MISSING:
        raise Unavailable(browser.MISSING)
    answers, paints, bare = [], [], []
    with _served(run_dir) as address:
        page = f"{address}/run/0/"
        began_s = time.perf_counter()
        httpx.get(page, timeout=120.0, trust_env=False).raise_for_status()
        first_ms = 1e3 * (time.perf_counter() - began_s)
        for _ in range(rounds):
            began_s = time.perf_counter()
            size = len(httpx.get(page, timeout=120.0, trust_env=False).raise_for_status().content)
            answers.append(1e3 * (time.perf_counter() - began_s))
        with browser.browser() as window:
            window.size(1280, 900)
            for _ in range(rounds + 1):
                window.open(page)
                paints.append(float(window.until(FIRST_PAINT)))
                window.open(BARE_PAGE)
                bare.append(float(window.until(FIRST_PAINT)))
    return {
        "page_kb": round(size / 1e3, 1),
        "first_answer_ms": round(first_ms, 1),
        "answer_ms": round(statistics.median(answers), 1),
        "first_paint_ms": round(statistics.median(paints[1:]), 1),
        "bare_page_paint_ms": round(statistics.median(bare[1:]), 1),
        "first_paint_most_ms": round(max(paints), 1),
    }
