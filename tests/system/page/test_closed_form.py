"""Cycles in closed form on the page, in a real Chromium: branches over a diagram, folds over thresholds."""

import re
from pathlib import Path
from typing import Any

import httpx2
import pytest
from browser import download, needs_chromium, opened, wait_shown
from scripted import DEADLINE, Held, wait_for
from served import done, service_at
from studies import spec_of

from kernel.cycles.starts import cycles_at
from kernel.cycles.thresholds import thresholds
from kernel.params import Cell
from worker.executors.dask import Dask

pytestmark = needs_chromium

#: A hysteresis loop with the frequencies of an S-shaped branch and of a tip.
LOOP = spec_of((0.45, 1.1, 66), (0.5, 0.75, 11), 0.05, name="Closed form", ramp="both", window=(120, 30, 24))

#: Positions on the plot, in CSS pixels, of pixels in the colour of a property of the style sheet.
PIXELS = """([selector, property]) => {
    const canvas = document.querySelector(selector);
    if (!canvas?.width) return []; // nothing is drawn yet
    const hex = getComputedStyle(document.documentElement).getPropertyValue(property).match(/#\\w+/)[0];
    const wanted = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
    const { data, width } = pixels(canvas);
    const ratio = canvas.width / canvas.clientWidth;
    const found = [];
    for (let i = 0; i < data.length; i += 4) {
        if (wanted.every((value, j) => Math.abs(data[i + j] - value) < 3)) {
            found.push([(i / 4 % width) / ratio, Math.floor(i / 4 / width) / ratio]);
        }
    }
    return found;
}"""
PLOT = ".panel .plot canvas"


@pytest.fixture(scope="module")
def loop(address: str) -> str:
    return done(address, LOOP)


def branch_pixels(page: Any) -> list[list[float]]:
    """Where the plot has the colour of branches, from the left."""
    found: list[list[float]] = page.evaluate(PIXELS, [PLOT, "--branch"])
    return sorted(found)


def readout_at(page: Any, at: list[float]) -> str:
    box = page.locator(PLOT).first.bounding_box()
    page.mouse.move(box["x"] + at[0], box["y"] + at[1])
    return str(page.locator(".panel .readout").inner_text())


#: A curve through points of a parabola, in pixels of a plot, Γ from 0.5 to 0.5 + 1e-6, φ from 4 to 4.001.
CURVE = """import(new URL("static/js/plot/drawing.js", location)).then(({ curve }) => {
    const axis = (low, width) => ({ pixel: (value) => (1000 * (value - low)) / width });
    const box = { left: 0, top: 0, width: 1000, height: 1000, x: axis(0.5, 1e-6), y: axis(4, 0.001) };
    const times = Array.from({ length: 60 }, (_, i) => 3.7 + 0.016 * i);
    const points = times.map((y) => [0.5 + (y - 4.0004) ** 2, y]);
    return curve([...points, null, [9, 9]], box).filter(Boolean);
})"""

#: The texts of the ticks of a window that is as narrow as any may be.
TICKS = """import(new URL("static/js/plot/scale.js", location)).then(
    ({ ticks }) => ticks(0.5532445932, 0.5532445932 + 8e-13, 6).map(({ text }) => text))"""


def test_a_window_shows_a_branch_as_the_curve_that_it_is(browser: Any, address: str):
    with opened(browser, address) as page:
        drawn, ticks = page.evaluate(CURVE), page.evaluate(TICKS)
    assert len(set(ticks)) == len(ticks) > 3
    assert 150 < len(drawn) < 1000
    for x, y in drawn:
        assert x == pytest.approx(1e9 * (1e-6 * y - 0.0004) ** 2, abs=0.01)


def test_branches_over_a_diagram_and_an_unstable_cycle_in_motion(browser: Any, address: str, loop: str):
    with opened(browser, f"{address}/#/job/{loop}/diagram?omega=0.6&xi=0.05") as page:
        wait_shown(page, omega=0.6)
        assert branch_pixels(page) == []
        page.get_by_label("Branches").check()
        wait_for(lambda: len(branch_pixels(page)) > 200)
        wait_for(lambda: "branches=1" in page.evaluate("location.href"))

        # every cycle that is pointed at is one of the closed form, and some are unstable
        texts = {}
        for at in branch_pixels(page)[::60]:
            text = readout_at(page, at)
            if "unstable" in text and "(1, 1)" in text:
                texts[text] = at
        assert texts
        text, at = next(iter(texts.items()))
        readout_at(page, at)
        page.get_by_label("Branches").press("Space")  # the pointer is still on the cycle
        wait_for(lambda: branch_pixels(page) == [])
        page.get_by_label("Branches").press("Space")
        wait_for(lambda: len(branch_pixels(page)) > 200)
        match = re.search(
            r"Γ = ([\d.]+) · cycle \(1, 1\), unstable · flight time ([\d.]+) rad · multipliers", text
        )
        assert match
        gamma, time = map(float, match.groups())
        known = cycles_at(Cell(gamma, 0.6, 0.05), 1)
        assert abs(known.flight_time - time).min() < 0.05  # gamma is shown with five digits

        box = page.locator(PLOT).first.bounding_box()
        page.mouse.click(box["x"] + at[0], box["y"] + at[1])
        said = page.locator(".trajectory .readout", has_text="On the cycle (1, 1), unstable")
        said.wait_for()
        assert re.search(r"multipliers −?[\d.]+", said.inner_text())
        assert "on a cycle in closed form" in page.locator(".trajectory header .note").inner_text()
        with opened(browser, page.evaluate("location.href")) as again:  # the address shows the same cycle
            again.locator(".trajectory .readout", has_text="On the cycle (1, 1), unstable").wait_for()
        other = re.sub(r"cycle(%3A|:)1\1[\d.]+", r"cycle\g<1>1\g<1>9", page.evaluate("location.href"))
        with opened(browser, other) as again:  # of a flight that no cycle (1, 1) has
            again.locator(".trajectory .readout", has_text="Not on the cycle pressed, but on a").wait_for()


def test_an_event_is_read_where_it_is_marked_and_its_spring_explored(browser: Any, address: str, loop: str):
    with opened(browser, f"{address}/#/job/{loop}/diagram?omega=0.6&xi=0.05&branches=1") as page:
        wait_shown(page, omega=0.6)
        wait_for(lambda: len(branch_pixels(page)) > 200)
        box = page.locator(PLOT).first.bounding_box()
        beside = [at for at in branch_pixels(page)[::4] if 0.35 < at[0] / box["width"] < 0.55]
        texts = {readout_at(page, at): at for at in beside}
        flip = "flip (1, 1) · Γ = 0.7243831 · φ = 4.42474 rad · Ω = 0.6, ξ = 0.05 · press to see it move"
        page.mouse.click(box["x"] + texts[flip][0], box["y"] + texts[flip][1])
        said = page.locator(".trajectory .readout", has_text="On the cycle (1, 1)").inner_text()
        page.get_by_role("link", name="Explore this spring").click()
        page.wait_for_url(re.compile(r"#/explore\?gamma=0\.7\d+&omega=0\.6&xi=0\.05&cell=.*,cycle"))
        page.locator(".closed", has_text="Rest ends at Γ = ").wait_for()
        assert page.locator(".trajectory .readout", has_text="On the cycle (1, 1)").inner_text() == said
    with opened(browser, f"{address}/#/job/{loop}/thresholds?xi=0.05&folds=1") as page:
        wait_for(lambda: len(branch_pixels(page)) > 200)
        texts = {readout_at(page, at): at for at in branch_pixels(page)[::60]}
        assert any(re.match(r"fold \(1, 1\) · Γ = 0\.\d+ · φ = .* · Ω = .*; Ω = ", text) for text in texts)


def test_a_branch_is_read_between_its_points(browser: Any, address: str):
    cycles = {"omega": 0.8, "xi": 0.05, "protocol": {"kind": "orbits"}, "modes": ["1-2"], "points": 20}
    with opened(browser, f"{address}/#/job/{done(address, cycles)}/cycles") as page:
        wait_for(lambda: len(branch_pixels(page)) > 200)
        right_of_names = [at for at in branch_pixels(page) if at[0] > 600.0]
        texts = [readout_at(page, at) for at in right_of_names[::10]]
        assert len(texts) > 5
        assert all("cycle (1, 2)" in text for text in texts), texts
        page.locator(".panel .plot").press("Home")
        read = [page.locator(".panel .readout").inner_text()]
        for _ in range(4):
            page.locator(".panel .plot").press("ArrowRight")
            read.append(page.locator(".panel .readout").inner_text())
        assert len(set(read)) == len(read)  # each press goes to another cycle


def test_cycles_and_folds_of_a_soft_sweep_are_its_own(browser: Any, address: str):
    """An unstable cycle that is pressed moves on the sweep's contact."""
    soft = done(address, LOOP | {"name": "Soft", "omega": [0.55, 0.6, 0.65], "model": {"kind": "soft"}})
    where = f"{address}/#/job/{soft}/diagram?omega=0.6&xi=0.05&branches=1"
    with opened(browser, where) as page:
        wait_shown(page, omega=0.6)
        wait_for(lambda: len(branch_pixels(page)) > 200)
        assert "unstable cycle" in download(page.get_by_role("button", name="Download SVG")).read_text()
        with page.expect_request(re.compile("format=csv")) as request:  # which has none of them
            page.get_by_label("Download CSV").first.click()
        assert "branches" not in request.value.url
        texts = {readout_at(page, at): at for at in branch_pixels(page)[::60]}
        at = next(at for text, at in texts.items() if "unstable" in text and "(1, 1)" in text)
        box = page.locator(PLOT).first.bounding_box()
        page.mouse.click(box["x"] + at[0], box["y"] + at[1])
        page.locator(".trajectory .readout", has_text="On the cycle (").wait_for()
        assert "on a cycle of this contact" in page.locator(".trajectory header .note").inner_text()
    with opened(browser, f"{address}/#/job/{soft}/thresholds?xi=0.05&folds=1") as page:
        wait_for(lambda: len(branch_pixels(page)) > 200)
    other = spec_of((0.5, 1.0, 6), 0.6, 0.05, window=(5, 5, 5), model={"kind": "soft", "rest_length": 9})
    with opened(browser, f"{address}/#/job/{done(address, other)}/diagram?branches=1") as page:
        texts = page.locator(".panel .plot .texts", has_text="unstable, ideal plate")
        texts.wait_for(state="attached")


def test_branches_of_cells_follow_a_sweep_that_runs(
    browser: Any, cluster: Dask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    held = Held()
    monkeypatch.setattr(held, "call", cluster.call)  # only cells wait
    with service_at(tmp_path, held) as address:
        spec = spec_of(0.88, (0.54, 0.63, 10), 0.05, window=(300, 30, 8))
        job = httpx2.post(f"{address}/v1/jobs", json=spec, timeout=DEADLINE).json()
        with opened(browser, f"{address}/#/job/{job['id']}/diagram?along=omega&branches=1") as page:
            page.get_by_text("Not computed yet", exact=True).wait_for()
            wait_for(lambda: page.locator(".closed-form .note").inner_text() == "")
            orbits = {"omega": 0.8, "xi": 0.05, "protocol": {"kind": "orbits"}, "modes": ["1-1"]}
            cycles = httpx2.post(f"{address}/v1/jobs", json=orbits, timeout=DEADLINE).json()
            with opened(browser, f"{address}/#/job/{cycles['id']}/cycles") as other:
                other.get_by_text("Not computed yet", exact=True).wait_for()
            held.let_go()
            wait_for(lambda: len(branch_pixels(page)) > 200)


def test_branches_are_drawn_at_their_frequency_alone(browser: Any, address: str, loop: str):
    with opened(browser, f"{address}/#/job/{loop}/diagram?omega=0.6&xi=0.05&branches=1") as page:
        wait_for(lambda: len(branch_pixels(page)) > 200)
        page.route("**/v1/orbits?*", lambda route: None)  # without an answer
        page.get_by_role("slider").first.press("ArrowRight")
        wait_shown(page, omega=0.625)
        assert branch_pixels(page) == []


def test_folds_through_the_thresholds(browser: Any, address: str, loop: str):
    with opened(browser, f"{address}/#/job/{loop}/thresholds?xi=0.05") as page:
        wait_shown(page, xi=0.05)
        page.get_by_label("Folds").check()
        wait_for(lambda: len(branch_pixels(page)) > 200)
        assert page.locator(".closed-form .note").inner_text() == ""
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")  # the middle frequency, 0.625
        said = page.locator(".panel .readout", has_text="closed form: ").inner_text()
        assert f"{thresholds(0.625, 0.05).down:.6g}" in said
        assert "cause: fold (1, 1)" in said
        page.set_viewport_size({"width": 390, "height": 844})  # of a phone
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_the_form_asks_for_a_start_on_a_cycle_and_keeps_it(browser: Any, address: str):
    seeded = {
        **LOOP, "name": "seeded", "gamma": {"start": 0.555, "stop": 0.6, "num": 5}, "omega": 0.6,
        "protocol": {"kind": "ramp", "axis": "gamma", "direction": "down", "start": {"periods": 1}},
    }  # fmt: skip
    view = httpx2.post(f"{address}/v1/jobs", json=seeded, timeout=DEADLINE).raise_for_status().json()
    with opened(browser, f"{address}/#/new?from={view['id']}", expected=("422",)) as page:
        page.locator(".cost").filter(has_text="cells in").wait_for()
        first = page.get_by_label("first cell")
        assert first.input_value() == "1"
        first.fill("2")
        refused = page.locator("[data-field='protocol.start'][aria-invalid=true]")
        refused.wait_for()
        assert "there is no stable cycle (1, 2) at gamma 0.6" in page.locator(".error").inner_text()
        first.fill("1")
        page.locator(".cost").filter(has_text="cells in").wait_for()
        page.get_by_role("button", name="Compute").click()
        page.wait_for_url(re.compile(f"#/job/{view['id']}"))  # the same specification is the same job
        page.locator("header.job .summary", has_text="ramp down along Γ from the cycle (1, 1)").wait_for()
