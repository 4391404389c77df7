"""A Chromium without a window: pages as a reader sees them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def chromium() -> Iterator[Browser]:
    """Launch the Chromium or Chrome of this machine; skip the test where there is none."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("neither Chromium nor Chrome is installed")
    driver = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with driver.sync_playwright() as play:
        # Without its sandbox it runs as root, in a container as well; it opens files of this project alone.
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def opened(browser: Browser, path: Path, width: int = 1400, height: int = 1000) -> tuple[Page, list[str]]:
    """Open a report and wait for its first screen; the list gathers what it says on the console and asks for."""
    page = browser.new_page(viewport={"width": width, "height": height})
    heard: list[str] = []
    page.on("console", lambda message: heard.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: heard.append(f"error: {error}"))
    page.on("request", lambda request: heard.append(f"request: {request.url}"))
    page.goto(path.resolve().as_uri())
    # The page forbids evaluation, which wait_for_function needs.
    page.wait_for_selector("body[data-ready=yes]")
    return page, heard


def read_through(page: Page) -> None:
    """Scroll to the end, as a reader does, and back."""
    for _ in range(100):
        page.mouse.wheel(0, 900)
        page.wait_for_timeout(60)
        if page.evaluate("innerHeight + scrollY >= document.documentElement.scrollHeight - 2"):
            break
    page.evaluate("scrollTo(0, 0)")


def open_everything(page: Page) -> None:
    """Open every fold, also those inside."""
    for _ in range(5):
        closed = "document.querySelectorAll('details:not([open])')"
        if not page.evaluate(f"{closed}.length"):
            break
        page.evaluate(f"{closed}.forEach((d) => (d.open = true))")
        page.wait_for_timeout(100)
