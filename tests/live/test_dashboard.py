"""The dashboard in headless Chromium: live figures, finds opened by keys, orders, a phone, a small page."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import browser
import msgspec
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "console"))

from dashboard_runs import make_run

from saflite.console.view.dashboard import pages
from saflite.console.view.dashboard.source import RunSource

pytestmark = [pytest.mark.live, pytest.mark.skipif(bool(browser.MISSING), reason=browser.MISSING or "there is one")]
EXAMPLES = Path(__file__).resolve().parents[2] / "deploy" / "examples" / "targets"
SAFLITE = [sys.executable, "-m", "saflite"]
SENT_BYTES_MAX = 100_000
"""Page, style and script of a run; charts come when they are looked at."""
FIRST_PAINT_MS = "return performance.getEntriesByName('first-contentful-paint')[0]?.startTime || 0"


@contextmanager
def served(*words: str) -> Iterator[str]:
    """A dashboard over runs, ended by a signal; yields its address."""
    command = [*SAFLITE, "dashboard", *words, "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[1].rstrip("/")
    finally:
        process.terminate()
        process.wait(20)


@pytest.fixture(scope="module")
def window() -> Iterator[browser.Browser]:
    with browser.browser() as opened:
        yield opened


def test_a_find_is_opened_by_keys_beside_a_good_flight(window: browser.Browser, tmp_path: Path) -> None:
    runs = [make_run(tmp_path / name, 30, rng_seed=seed) for seed, name in enumerate(("one", "two"))]
    with served(*map(str, runs)) as address:
        window.size(1280, 900)
        window.open(address)
        assert window.run("return document.querySelectorAll('tbody a[href^=\"/run/\"]').length") >= 2
        window.open(f"{address}/run/0/")
        window.until("document.querySelector('[data-part=search] svg')")
        window.keys("j")
        window.keys("\ue007")
        window.until("document.querySelector('#find[open] svg.layout')")
        assert window.run("return document.querySelector('.beside') !== null || /No flight before/.test("
                          "document.querySelector('#find-content').textContent)")  # fmt: skip
        window.keys("\ue00c")
        window.until("!document.querySelector('#find').open")


def test_finds_that_come_in_leave_the_reader_where_he_is(window: browser.Browser, tmp_path: Path) -> None:
    """One more find arrives in a table that is sorted and filtered, while the reader types."""
    run = make_run(tmp_path / "run", 12)
    one = RunSource(run).violations(public=False)[0]
    many = [msgspec.structs.replace(one, test_case=f"{at:016x}", fingerprint=f"{7 * at % 9}e{at}") for at in range(9)]
    field, rows = "document.querySelector('input.filter')", "[...document.querySelectorAll('tr.find')]"
    names = f"{rows}.filter(row => !row.hidden).map(row => row.cells[0].textContent)"
    with served(str(run)) as address:
        window.size(1280, 900)
        window.open(f"{address}/run/0/")
        window.until("shown >= 0")
        window.run("window.arrive = told; window.told = () => {}")  # what the books tell comes whenever it comes
        window.run("arrive(arguments[0])", pages.finds(many[:8]))
        window.run("document.querySelector('#finds th').click()")
        window.keys("jjj")
        chosen = window.run("return document.querySelector('tr.here').dataset.find")
        window.run(f"{field}.focus()")
        window.keys("e")
        window.run("arrive(arguments[0])", pages.finds(many))
        assert window.run(f"return document.activeElement === {field}"), "the keyboard stays where it was"
        assert window.run(f"return {field}.value") == "e"
        assert window.run(f"return {names}") == sorted(one.fingerprint for one in many), "sorted as it was"
        assert window.run("return document.querySelector('tr.here').dataset.find") == chosen


def test_what_the_server_refuses_is_told_as_words(window: browser.Browser, tmp_path: Path) -> None:
    """An address from elsewhere names a find that is none: the answer, which repeats the name, is no markup."""
    markup = "<b class=evil>sign in again"
    with served(str(make_run(tmp_path / "run", 2))) as address:
        window.size(1280, 900)
        window.open(f"{address}/run/0/")
        window.until("shown >= 0")
        window.run("open_(arguments[0])", markup)
        window.until("/one of a find/.test(document.querySelector('#find-content').textContent)")
        assert window.run("return document.querySelector('.evil')") is None
        assert markup in window.run("return document.querySelector('#find-content').textContent")


def test_ctrl_c_ends_it_though_a_page_is_open(window: browser.Browser, tmp_path: Path) -> None:
    command = [*SAFLITE, "dashboard", str(make_run(tmp_path / "run", 12)), "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    window.open(process.stdout.readline().split()[1])
    window.until("shown >= 0")  # the stream of figures is open
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert (process.returncode, said) == (0, "")


def test_dark_mode_and_a_phone(window: browser.Browser, tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 20)
    with served(str(run)) as address:
        window.size(390, 844, phone=True)
        window.dark(on=True)
        window.open(address)
        window.until("document.querySelector('tr.find')")
        ground = "getComputedStyle(document.body).backgroundColor"
        assert window.run(f"return {ground}") == "rgb(18, 22, 29)"
        window.run("document.querySelector('tr.find').click()")
        window.until("document.querySelector('#find[open] svg.layout')")
        assert window.run("return document.documentElement.scrollWidth <= innerWidth"), "nothing sticks out sideways"
        window.run("document.querySelector('#find .close').click()")
        window.keys("d")
        assert window.run(f"return {ground}") == "rgb(246, 247, 249)"
        window.run("localStorage.clear()")
        window.dark(on=False)


def test_a_running_campaign_is_paused_and_goes_on(window: browser.Browser, tmp_path: Path) -> None:
    for name in ("point-mass.toml", "point-mass-stays.toml", "point_mass.py"):
        (tmp_path / name).write_bytes((EXAMPLES / name).read_bytes())
    words = ["run", "point-mass.toml", "--module", "point_mass.py", "--out", "run", "--budget", "100000", "--json"]
    farm = subprocess.Popen([*SAFLITE, *words, "--minutes", "3"], cwd=tmp_path, stdout=subprocess.DEVNULL)
    try:
        for _ in range(600):
            if (tmp_path / "run" / "farm.json").exists() or farm.poll() is not None:
                break
            time.sleep(0.1)
        with served(str(tmp_path / "run")) as address:
            window.size(1280, 900)
            window.open(address)
            window.until("document.querySelector('.state').dataset.state === 'running'")
            window.until("parseInt(document.querySelector('[data-figure=flights]').textContent) > 0")
            window.until("document.querySelectorAll('#workers tbody tr').length >= 4")
            window.keys("p")
            window.until("document.querySelector('.state').dataset.state === 'paused'")
            window.run(
                "const form = document.querySelector('#budget'); form.number.value = 200000; form.requestSubmit()"
            )
            window.until("document.querySelector('[data-figure=flights]').textContent.endsWith('of 200000')")
            window.run(
                "const form = document.querySelector('#scorer'); form.model.value = 'novelty'; form.requestSubmit()"
            )
            window.keys("p")
            window.until("document.querySelector('.state').dataset.state === 'running'")
            window.until("document.querySelector('[data-figure=scorer]').textContent.startsWith('novelty')")
    finally:
        farm.terminate()
        farm.wait(60)


def test_what_is_sent_before_the_first_paint_is_little(window: browser.Browser, tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", 300, checked=False)
    with served(str(run)) as address:
        window.size(1280, 900)
        window.open(f"{address}/run/0/")
        window.until(FIRST_PAINT_MS.removeprefix("return "))
        assert "300 of 300" in window.run("return document.querySelector('[data-figure=flights]').textContent")
        assert window.run("return document.querySelectorAll('tr.find').length") <= pages.FINDS_SHOWN
        sent = window.run(
            "return performance.getEntriesByType('navigation').concat(performance.getEntriesByType('resource'))"
            ".filter(one=>/\\/run\\/0\\/$|assets/.test(one.name)).map(one=>one.decodedBodySize)"
        )
        assert len(sent) == 3
        assert sum(sent) < SENT_BYTES_MAX
