"""Basins on the page, in a real Chromium: the plane of starts, its legend, and a start in motion."""

from typing import Any

from browser import needs_chromium, opened, screenshot, wait_shown
from scripted import wait_for
from served import done

from service.client import Client
from service.pictures import ATTRACTORS

pytestmark = needs_chromium

#: Two cycles (1,1) at the larger Gamma, rest at the smaller.
DROPS: dict[str, Any] = {
    "name": "Where drops lead", "gamma": [0.6, 1.27], "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"},
    "protocol": {"kind": "basin", "rows": 24, "columns": 32}, "settle": 200,
}  # fmt: skip
#: Of the first two attractors.
COLOURS = ["rgb({}, {}, {})".format(*bytes.fromhex(colour[1:])) for colour in ATTRACTORS[:2]]


def test_a_start_is_read_and_seen_to_move(browser: Any, address: str):
    drops = done(address, DROPS)
    with Client(address) as client:
        found = client.job(drops).basins(1.27)
    with opened(browser, f"{address}/#/job/{drops}?gamma=1.27") as page:
        wait_shown(page, gamma=1.27, complete=True)
        assert page.locator(".tabs a").all_inner_texts() == ["Basins", "Details"]
        entries = page.locator(".panel .legend li").all_inner_texts()
        longest = found.attractor_longest_flight.values
        for text, flight, share in zip(entries, longest, found.attractor_fraction.values, strict=True):
            assert f"{flight:.4g}" in text
            assert f"{100 * share:.3g}" in text
        swatches = page.locator(".panel .legend .swatch")
        assert [swatches.nth(i).evaluate("e => e.style.background") for i in (0, 1)] == COLOURS
        assert "basin entropy" in page.locator(".panel").inner_text()

        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        said = page.locator(".panel .readout").inner_text()
        start = found.isel(row=found.sizes["row"] // 2, column=found.sizes["column"] // 2 + 1)
        assert f"height: {start.row.item():.5g}"[:11] in said
        assert f"{longest[start.attractor_of_start.item() - 1]:.4g}" in said
        page.keyboard.press("Enter")
        page.locator(".trajectory .readout", has_text="in 16 plate periods").wait_for()
        about = page.locator(".trajectory header .note").inner_text()
        assert "let go" in about
        assert page.locator(".trajectory h2").inner_text() == "Trajectory of a drop"
        wait_for(lambda: "cell=" in page.evaluate("location.href"))
        screenshot(page, "basins")
        with opened(browser, page.evaluate("location.href")) as again:  # the address shows the same start
            again.locator(".trajectory .readout", has_text="in 16 plate periods").wait_for()
            assert again.locator(".trajectory header .note").inner_text() == about
            again.set_viewport_size({"width": 390, "height": 844})  # of a phone
            assert again.evaluate("document.documentElement.scrollWidth <= innerWidth")
        with page.expect_download() as download:
            page.locator(".panel").get_by_label("Download NetCDF").click()
        assert download.value.suggested_filename == "where-drops-lead-basin.nc"
        page.locator("#slider-gamma").fill("0")  # another cell
        wait_shown(page, gamma=0.6)
        assert "at rest" in page.locator(".panel .legend").inner_text()
