"""Studies that are no plain sweeps on the page, in a real Chromium: maps, basins, attractors over a grid."""

import re
from pathlib import Path
from typing import Any

import httpx2
import pytest
from browser import download, needs_chromium, open_tab, opened, picture, wait_shown
from scripted import DEADLINE, wait_for
from served import done
from studies import spec_of

from service.client import Client
from service.pictures import ATTRACTORS

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


def test_a_ball_that_auto_chose_has_no_threshold_of_a_spring(browser: Any, address: str, tmp_path: Path):
    auto = {"kind": "auto", "tolerance": 10}
    job = done(address, spec_of((1.05, 1.6, 23), [0.02, 0.03], 0.3, model=auto))
    with Client(address) as client:
        file = client.job(job).share(tmp_path / "shared.html").as_uri()
    for place, offline in ((f"{address}/#/job/{job}", False), (file, True)):
        with opened(browser, place, offline=offline) as page:
            page.locator(".summary", has_text="auto → ball").wait_for()
            open_tab(page, "Thresholds")
            wait_shown(page, xi=0.3)
            assert "Eq. 25" not in page.locator(".panel .plot").inner_text()
            open_tab(page, "Details")
            page.get_by_role("heading", name="Selected model: ball").wait_for()


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
        page.get_by_label("Show which cells were computed").check()
        wait_for(lambda: picture(page) != plain)
        page.locator(".downloads", has_text="SVG and PDF lack the marks of computed cells.").wait_for()
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
        page.get_by_role("link", name="window of another sweep").click()
        page.locator("#bar h1", has_text=re.compile("^An adaptive map$")).wait_for()
        page.goto(f"{address}/#/new?from={parent}&gamma=1.7,3&omega=0.7,1.03&xi=0.05")
        page.locator(".cost", has_text="cells").wait_for()
        assert page.locator("[data-field='omega.start']").input_value() == "0.7"


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
        with opened(browser, page.evaluate("location.href")) as again:  # the address shows the same start
            again.locator(".trajectory .readout", has_text="in 16 plate periods").wait_for()
            assert again.locator(".trajectory header .note").inner_text() == about
            again.set_viewport_size({"width": 390, "height": 844})  # of a phone
            assert again.evaluate("document.documentElement.scrollWidth <= innerWidth")
        saved = download(page.locator(".panel").get_by_label("Download NetCDF"))
        assert saved.name == "where-drops-lead-basin.nc"
        page.locator("#slider-gamma").fill("0")  # another cell
        wait_shown(page, gamma=0.6)
        assert "at rest" in page.locator(".panel .legend").inner_text()


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
        assert any(re.search(r"birth of \(1,\s1\)\t\d", event) for event in events)

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
        assert download(page.get_by_label("Download CSV").first).name == "what-coexists-attractor-map.csv"
        page.locator(".panel .plot").press("+")
        page.locator(".downloads", has_text="hold everything, not only what is shown").wait_for()
