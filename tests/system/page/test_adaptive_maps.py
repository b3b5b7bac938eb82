"""Adaptive maps on the page: the form, the map and its computed cells, windows, in a real Chromium."""

import re
from typing import Any

import httpx2
import pytest
from browser import needs_chromium, opened, picture, screenshot, wait_shown
from scripted import DEADLINE, wait_for
from served import done
from studies import spec_of

pytestmark = needs_chromium

MAP = spec_of(
    (0.3, 4.2, 257), (0.28, 1.4, 257), 0.05, name="An adaptive map", window=(40, 20, 8), refine={"by": "mode"}
)


def job_of(address: str, id: str) -> dict[str, Any]:
    view: dict[str, Any] = httpx2.get(f"{address}/v1/jobs/{id}", timeout=DEADLINE).json()
    return view


def test_the_form_keeps_the_exponents_of_a_map(browser: Any, address: str):
    parent = done(address, MAP | {"gamma": 2.5, "omega": [0.4, 0.6, 0.8], "exponents": 1})
    with opened(browser, f"{address}/#/new?from={parent}") as page:
        page.locator("button.button:enabled", has_text="Compute").click()
        page.wait_for_url(re.compile(f"#/job/{parent}"))  # the same study


def test_a_map_shows_its_computed_cells_and_a_window_of_it_is_refined(browser: Any, address: str):
    parent = done(address, MAP)
    share = httpx2.get(f"{address}/v1/jobs/{parent}/modes", timeout=DEADLINE).json()["attrs"][
        "computed_share"
    ]
    with opened(browser, f"{address}/#/job/{parent}/modes") as page:
        wait_shown(page, xi=0.05)
        note = page.locator(".panel .note", has_text="Adaptive map")
        note.wait_for()
        shown = re.search(r"([\d.]+) %", note.inner_text())
        assert shown is not None
        assert float(shown[1]) == pytest.approx(100 * share, rel=0.05)
        assert page.get_by_label("Count flights above").count() == 0
        plain = picture(page)
        screenshot(page, "modes-adaptive")
        page.get_by_label("Show which cells were computed").check()
        wait_for(lambda: picture(page) != plain)
        page.locator(".downloads", has_text="SVG and PDF lack the marks of computed cells.").wait_for()
        screenshot(page, "modes-computed")
        page.get_by_label("Show which cells were computed").uncheck()
        plot = page.locator(".panel .plot")
        plot.focus()
        for _ in range(2):
            page.keyboard.press("ArrowRight")
        assert re.search("computed|taken from its block", page.locator(".panel .readout").inner_text())
        for _ in range(4):
            page.keyboard.press("+")
        page.wait_for_url(re.compile("x0="))
        page.get_by_role("button", name="Compute this window").click()
        page.locator(".cost", has_text=re.compile(r"about [\d,]+ to [\d,]+ of them computed")).wait_for()
        page.get_by_role("button", name="Compute", exact=True).click()
        page.wait_for_url(lambda url: "#/job/" in url and parent not in url)
        page.locator("#bar", has_text="Window of An adaptive map").wait_for()
        child = page.evaluate("location.href").split("/job/")[1][:32]
        wait_for(lambda: job_of(address, child)["state"] == "done")
        spec = job_of(address, child)["spec"]
        assert spec["parent"] == parent
        assert 0.3 < spec["gamma"]["start"] < spec["gamma"]["stop"] < 4.2
        wait_shown(page, xi=0.05)
        page.locator(".panel .note", has_text="Adaptive map").wait_for()
        screenshot(page, "modes-window")
        page.get_by_role("link", name="window of another sweep").click()
        page.locator("#bar h1", has_text=re.compile("^An adaptive map$")).wait_for()
