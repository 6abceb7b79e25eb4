"""One browser for all tests of pages."""

from collections.abc import Iterator

import pytest

from .browser import Browser, chromium


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Skips where it is not installed."""
    if chromium() is None:
        pytest.skip("chromium is not installed")
    with Browser() as opened:
        yield opened
