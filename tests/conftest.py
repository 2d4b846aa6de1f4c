"""Live tests are skipped, with the reason, unless asked for; no generated test case has a time limit."""

from __future__ import annotations

import pytest
from hypothesis import settings

settings.register_profile("farm", deadline=None)  # a busy machine is no defect; speed is for benchmarks
settings.load_profile("farm")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--live", action="store_true", help="run live tests too: real processes, network, model servers")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--live"):
        return
    skip = pytest.mark.skip(reason="live test: run with --live (scripts/test --live)")
    for item in items:
        if "live" in item.keywords:
            item.add_marker(skip)
