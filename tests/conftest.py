"""Live tests and golden searches are skipped, with the reason, unless asked for.

No generated test case has a time limit. Processes that tests start hear signals, however the tests were started.
"""

from __future__ import annotations

import gc
import signal

import pytest
from hypothesis import settings

settings.register_profile("farm", deadline=None)  # a busy machine is no defect; speed is for benchmarks
settings.load_profile("farm")

# A shell's background job, and nohup, ignore these two; ignoring is inherited, also by the farms that tests stop.
for _ending, _usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_ending) is signal.SIG_IGN:
        signal.signal(_ending, _usual)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--live", action="store_true", help="run live tests too: real processes, network, model servers")
    parser.addoption("--golden", action="store_true", help="repeat the golden searches too: some minutes")


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()  # ten thousand tests are looked through at every collection otherwise, for a twentieth of the time


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for mark, how in (("live", "scripts/test --live"), ("golden", "scripts/golden")):
        if config.getoption(f"--{mark}"):
            continue
        skip = pytest.mark.skip(reason=f"{mark} test: run by {how}")
        for item in items:
            if mark in item.keywords:
                item.add_marker(skip)
