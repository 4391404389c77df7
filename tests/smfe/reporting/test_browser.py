"""The report as a reader sees it, in Chromium: the first screen, the keyboard, narrow screens, paper, other eyes."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from kept import kept
from matplotlib.image import imread
from pypdf import PdfReader
from samples.browser import open_everything, opened, read_through
from samples.demonstration import full_demo
from samples.report import write_reported

from smfe.commands.demo import DEMO_SEED
from smfe.reporting.content.results import read_results

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

MOST_STOPS, MOST_NODES, MOST_BYTES = 25, 5000, 3e6

INTERACTIVE = "button, input, summary, a[href], select, [tabindex='0']"


@pytest.fixture(scope="module", params=["sample", pytest.param("demo", marks=pytest.mark.slow)])
def folder(request: pytest.FixtureRequest) -> Path:
    """Folder of results: one that holds a bit of everything, and that of the demonstration."""
    return kept(write_reported) if request.param == "sample" else kept(full_demo, DEMO_SEED) / "results"


@dataclass(frozen=True)
class Reader:
    """A page that all tests read one after the other, and what was counted and heard before the first of them."""

    page: Page
    heard: list[str]
    nodes: int


@pytest.fixture(scope="module")
def reader(browser: Browser, folder: Path) -> Iterator[Reader]:
    page, heard = opened(browser, folder / "report.html")
    yield Reader(page, heard, page.evaluate("document.querySelectorAll('*').length"))
    page.close()


@pytest.fixture
def page(reader: Reader) -> Iterator[Page]:
    """The page as it was opened: wide, at its top, nothing unfolded."""
    yield reader.page
    reader.page.set_viewport_size({"width": 1400, "height": 1000})
    reader.page.evaluate("""() => {
        document.querySelectorAll("details[open]").forEach((d) => (d.open = false));
        document.activeElement.blur();
        scrollTo(0, 0);
    }""")


def box(page: Page, selector: str) -> dict[str, float]:
    found = page.locator(selector).first.bounding_box()
    assert found is not None, selector
    return dict(found)


class TestFirstScreen:
    def test_it_holds_the_answer_and_the_diagram(self, page: Page, folder: Path) -> None:
        best = read_results(folder).best
        element = page.locator("#answer")
        for key in ("spindle_speed_rpm", "depth_of_cut_mm", "source", "reason"):
            text = element.get_attribute(f"data-{key.replace('_', '-')}")
            assert text == (best[key] if isinstance(best[key], str) else str(best[key]))
        values = page.locator(".tiles dd").all_inner_texts()
        assert values[0] == f"{best['spindle_speed_rpm']:g} rpm"
        assert values[1] == f"{best['depth_of_cut_mm']:g} mm"
        for selector in (".said", ".advice .plot"):
            place = box(page, selector)
            assert place["y"] >= 0.0
            assert place["y"] + place["height"] <= 1000.0, selector
        # Drawn, with the recommended cut on it.
        assert page.locator(".advice:not([hidden]) .plot .scatterlayer .trace").count() >= 3
        assert page.locator(".advice:not([hidden]) .annotation-text", has_text=" rpm, ").count() == 1

    def test_it_is_light(self, reader: Reader, folder: Path) -> None:
        assert (folder / "report.html").stat().st_size <= MOST_BYTES
        assert reader.nodes <= MOST_NODES

    def test_every_part_is_named_for_those_who_hear_it(self, page: Page) -> None:
        assert page.locator("main").count() == 1
        for where, what in (
            ("section:not([aria-labelledby])", "sections without a heading"),
            ("main .plot:not(figure .plot)", "plots outside a figure"),
            (".plot:not([aria-label])", "plots without a name"),
            ("main thead th:not([scope])", "headers without a scope"),
            ("main img:not([alt])", "pictures without a name"),
        ):
            assert page.locator(where).count() == 0, what
        for name in page.locator("section").evaluate_all("all => all.map(s => s.getAttribute('aria-labelledby'))"):
            assert page.locator(f"#{name}").count() == 1
        for target in page.locator("nav a").evaluate_all("all => all.map(a => a.getAttribute('href'))"):
            assert page.locator(f"section{target}").count() == 1


def stops(page: Page) -> list[str]:
    """Return what the tabulator reaches from the top of the page, in order."""
    out: list[str] = []
    page.evaluate("() => { document.activeElement.blur(); window.counted = new Map(); }")
    name = """() => {
        const at = document.activeElement;
        if (!at || at === document.body) return "";
        if (!window.counted.has(at)) window.counted.set(at, window.counted.size + 1);
        return window.counted.get(at) + " " + at.tagName + " " + (at.textContent || at.name || "").trim().slice(0, 40);
    }"""
    for _ in range(200):
        page.keyboard.press("Tab")
        found = page.evaluate(name)
        if not found or found in out:
            break
        out.append(found)
    return out


class TestKeyboard:
    def test_few_stops_and_no_switch_is_left_out(self, page: Page) -> None:
        read_through(page)
        found = stops(page)
        assert len(found) <= MOST_STOPS, found
        # A bar of buttons or links, the cutting tests, a group of radio buttons: one stop each; arrows reach the rest.
        left = page.evaluate(
            """(interactive) => [...document.querySelectorAll(interactive)].filter((part) => {
                if (!part.checkVisibility() || window.counted.has(part)) return false;
                const bar = part.closest("[role=toolbar], table.cuts");
                if (bar) return ![...bar.querySelectorAll("*")].some((other) => window.counted.has(other));
                if (part.type !== "radio") return true;
                return ![...document.getElementsByName(part.name)].some((other) => window.counted.has(other));
            }).map((part) => part.outerHTML.slice(0, 90))""",
            INTERACTIVE,
        )
        assert left == []
        assert page.locator("svg [role=button], svg a[href], .updatemenu-button").count() == 0

    def test_the_first_stop_skips_to_the_content_and_is_seen(self, page: Page) -> None:
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.getAttribute('href')") == "#main"
        place = box(page, ".skip")
        assert place["x"] >= 0.0
        assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none"

    def test_arrows_and_space_switch_a_line(self, page: Page) -> None:
        toolbar = page.locator(".advice:not([hidden]) [role=toolbar]")
        shown = ".advice:not([hidden]) .plot .scatterlayer .trace"
        before = page.locator(shown).count()
        toolbar.locator("button").first.focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Space")
        second = toolbar.locator("button").nth(1)
        assert second.get_attribute("aria-pressed") == "false"
        assert page.locator(shown).count() < before
        page.keyboard.press("Space")
        assert page.locator(shown).count() == before

    def test_arrows_choose_what_the_compliances_show(self, page: Page) -> None:
        plot = page.locator("#plot-compliance")
        plot.scroll_into_view_if_needed()
        page.wait_for_selector("#plot-compliance .ytitle")
        assert (page.locator("#plot-compliance .ytitle").first.text_content() or "").startswith("magnitude")
        page.locator("input[name=plot-compliance-view]").first.focus()
        page.keyboard.press("ArrowRight")
        page.wait_for_selector("#plot-compliance .ytitle:text('phase')")
        assert (page.locator("#plot-compliance .ytitle").first.text_content() or "").startswith("phase")


class TestScreensAndPaper:
    @pytest.mark.parametrize("width", [700, 390])
    def test_nothing_sticks_out(self, page: Page, width: int) -> None:
        page.set_viewport_size({"width": width, "height": 844})
        open_everything(page)
        read_through(page)
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0

    def test_nothing_is_fetched_and_nothing_fails(self, page: Page, reader: Reader, folder: Path) -> None:
        open_everything(page)
        read_through(page)
        assert reader.heard == [f"request: {(folder / 'report.html').resolve().as_uri()}"]
        undrawn = page.locator(".plot:empty").evaluate_all("all => all.filter(p => p.clientWidth).map(p => p.id)")
        assert undrawn == []

    def test_answer_and_diagram_print_on_two_pages(self, page: Page) -> None:
        document = page.pdf(format="A4", prefer_css_page_size=True, print_background=True)
        texts = [p.extract_text() for p in PdfReader(io.BytesIO(document)).pages]
        assert "Spindle speed" in texts[0]
        # The legend, the words in the diagram and its axis.
        for word in ("recommended cut", "stable", "chatter", "depth of cut"):
            assert word in texts[0], word
        assert "Every source and pocket" in texts[0] + texts[1]
        assert texts[2].lstrip().startswith("Cutting tests")


def lightness_and_colour(pixels: np.ndarray) -> np.ndarray:
    """Return CIELAB of sRGB colours between 0 and 1."""
    linear = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = linear @ to_xyz.T / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.stack([116.0 * f[..., 1] - 16.0, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])], -1)


def swatch_colour(button: Any) -> np.ndarray:
    """Return the colour of the line in a button of the legend, as the screen shows it."""
    pixels = imread(io.BytesIO(button.locator("svg").screenshot()))[..., :3]
    every = pixels.reshape(-1, 3)
    far = np.abs(every - 1.0).sum(axis=1)
    # The middle of the line: what is farthest from the white about it.
    return np.median(every[far > 0.9 * far.max()], axis=0)


class TestOtherEyes:
    def test_lines_differ_by_dash_label_and_colour_without_red_or_green(self, page: Page) -> None:
        traces = page.evaluate(
            """() => { const div = document.querySelector(".advice:not([hidden]) .plot");
            return [...div.querySelectorAll(".scatterlayer .trace")].map((trace) => {
                const path = trace.querySelector(".js-line"), look = path ? getComputedStyle(path) : {};
                return [look.strokeDasharray || "", look.strokeWidth || ""]; }); }"""
        )
        lines = [dash for dash, width in traces if width and float(width.removesuffix("px")) > 1.0]
        assert len(lines) >= 3
        assert len(set(lines)) == len(lines)
        session = page.context.new_cdp_session(page)
        session.send("Emulation.setEmulatedVisionDeficiency", {"type": "deuteranopia"})
        buttons = page.locator(".advice:not([hidden]) [role=toolbar] button:has(path[d='M0 6H26'])").all()
        names = [button.inner_text() for button in buttons]
        assert len(names) == len(lines)
        ends = page.locator(".advice:not([hidden]) .annotation-text").all_text_contents()
        assert set(names) <= set(ends)
        seen = [lightness_and_colour(swatch_colour(button)) for button in buttons]
        apart = {
            (a, b): np.linalg.norm(x - y) for (a, x), (b, y) in itertools.combinations(zip(names, seen, strict=True), 2)
        }
        # Ten steps that can just be told apart; beside each other on a screen two or three are enough.
        assert min(apart.values()) > 23.0, apart
