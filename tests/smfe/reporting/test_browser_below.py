"""The sections below the first screen as a reader opens them, in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from kept import kept
from samples.browser import opened
from samples.report import write_reported

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROWS = "table.cuts button.opens"


@pytest.fixture(scope="module")
def read(browser: Browser) -> Iterator[tuple[Page, list[str]]]:
    page, heard = opened(browser, kept(write_reported) / "report.html", 390, 844)
    yield page, heard
    page.close()


def becomes(page: Page, expression: str, wanted: object) -> bool:
    """Whether an expression of the page takes a value within ten seconds; the page forbids wait_for_function."""
    for _ in range(200):
        if page.evaluate(expression) == wanted:
            return True
        page.wait_for_timeout(50)
    return False


def test_a_row_opens_its_spectrum_and_spectrogram_by_keyboard(read: tuple[Page, list[str]]) -> None:
    page, heard = read
    assert page.locator("#cutting_tests .plot").count() == 0
    # All rows are one stop; arrows move between them.
    assert page.locator(f"{ROWS}[tabindex='0']").count() == 1
    page.locator(ROWS).first.focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_selector("#cutting_tests .plot .main-svg")
    page.locator("#cutting_tests .plot").last.scroll_into_view_if_needed()
    page.wait_for_selector("[id^=plot-spectrogram] .main-svg image")
    assert page.locator(ROWS).nth(1).get_attribute("aria-expanded") == "true"
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.keyboard.press("Enter")
    assert page.locator("#cutting_tests .plot").count() == 0
    assert [line for line in heard if not line.startswith(("request: file:", "request: data:"))] == []


def test_an_entry_alone_and_back(read: tuple[Page, list[str]]) -> None:
    page, _ = read
    page.locator("#plot-compliance").scroll_into_view_if_needed()
    # A phone begins with one entry; nine cannot be read there.
    page.wait_for_selector("#plot-compliance-entry")
    layout = "document.getElementById('plot-compliance')._fullLayout"
    select = page.locator("#plot-compliance-entry")
    width = f"Math.round(100 * ({layout}?.xaxis5.domain[1] - {layout}?.xaxis5.domain[0]))"
    assert becomes(page, width, 0)
    assert select.input_value() == "xx"
    select.select_option("")
    assert becomes(page, width, 32)
    select.select_option("yy")
    assert becomes(page, width, 100)
    shown = "document.getElementById('plot-compliance')._fullData.filter((t) => t.visible).map((t) => t.xaxis)"
    assert set(page.evaluate(shown)) == {"x5"}
    page.locator("#compliances input[type=radio]").nth(4).check()
    assert becomes(page, f"{layout}.yaxis5.title.text", "coherence [1]")
    select.select_option("")
    assert becomes(page, width, 32)


def test_a_long_table_is_made_when_it_is_opened(read: tuple[Page, list[str]]) -> None:
    page, _ = read
    fold = page.locator("#measured > details")
    assert fold.locator("td").count() == 0
    fold.locator("summary").first.click()
    inner = fold.locator("details[data-table]").first
    inner.locator("summary").click()
    inner.locator("tbody tr").first.wait_for()
    assert inner.locator("tbody tr").count() == 21
    assert inner.locator("tr.rejected").count() == 3
    assert inner.locator("th[scope=col]").count() > 5
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
