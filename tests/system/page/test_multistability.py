"""Attractors over a grid on the page, in a real Chromium: the diagram of all, the map, one in motion."""

import re
from typing import Any

import pytest
from browser import needs_chromium, opened, screenshot, wait_shown
from scripted import wait_for
from served import done
from studies import spec_of

from service.client import Client

pytestmark = needs_chromium

#: Hysteresis: (1,1) is born in a fold at gamma 0.5532 for omega 0.6; rest ends at the threshold of Eq. 25.
COEXISTING = {"name": "What coexists", "protocol": {"kind": "multistability"}, "settle": 600}
PLANE = spec_of((0.4, 1.1, 15), (0.5, 0.7, 5), 0.05, **COEXISTING)


@pytest.fixture(scope="module")
def job(address: str) -> str:
    return done(address, PLANE)


def test_the_diagram_shows_all_attractors_and_one_of_them_moves(browser: Any, address: str, job: str):
    with Client(address) as client:
        line = client.job(job).multistability(omega=0.6)
    with opened(browser, f"{address}/#/job/{job}?omega=0.6") as page:
        wait_shown(page, omega=0.6, complete=True)
        assert page.locator(".tabs a").all_inner_texts() == ["Diagram", "Map", "Details"]
        entries = page.locator(".panel .legend li").all_inner_texts()
        assert [entry.split(":")[0] for entry in entries] == line.attractor.astype(str).values.tolist()
        events = page.locator(".paged tbody tr").all_inner_texts()
        assert len(events) == line.sizes["event"]
        assert any(re.search(r"birth\t\d\t\(1, 1\)", event) for event in events)

        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowUp")
        cell = line.isel(omega=0, gamma=line.sizes["gamma"] // 2 + 1)
        place = cell.isel(place=min(1, cell["count"].item() - 1))
        said = page.locator(".panel .readout").inner_text()
        assert f"Γ = {cell.gamma.item():g}" in said
        assert f"attractor: {place.id.item()} · {place.label.item().replace(',', ', ')}" in said
        page.keyboard.press("Enter")
        page.locator(".trajectory .readout", has_text="in 16 plate periods").wait_for()
        assert page.locator(".trajectory h2").inner_text() == "Trajectory of an attractor"
        wait_for(lambda: "cell=" in page.evaluate("location.href"))
        screenshot(page, "attractors")
        page.set_viewport_size({"width": 390, "height": 844})  # of a phone
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_the_map_says_where_several_coexist(browser: Any, address: str, job: str):
    with opened(browser, f"{address}/#/job/{job}/map") as page:
        wait_shown(page, xi=0.05, complete=True)
        assert "Two attractors or more in" in page.locator(".panel").inner_text()
        plot = page.locator(".panel .plot canvas").first
        hatched = plot.evaluate("canvas => canvas.toDataURL()")
        page.get_by_label("Hatch cells with several attractors").uncheck()
        assert plot.evaluate("canvas => canvas.toDataURL()") != hatched
        page.get_by_label("Hatch cells with several attractors").check()
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowLeft")
        assert "attractor 1" in page.locator(".panel .readout").inner_text()
        page.keyboard.press("Enter")
        page.locator(".trajectory .readout", has_text="in 16 plate periods").wait_for()
        with page.expect_download() as download:
            page.get_by_label("Download CSV").first.click()
        assert download.value.suggested_filename == "what-coexists-attractor-map.csv"
        page.locator(".panel .plot").press("+")
        page.locator(".downloads", has_text="hold everything, not only what is shown").wait_for()
        screenshot(page, "attractor-map")
