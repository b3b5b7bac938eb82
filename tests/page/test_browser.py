"""The page in a real Chromium, on a real service."""

import json
import os
import re
import statistics
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import httpx2
import pytest
from browser import (
    LONG_LINE,
    ROOT,
    chromium,
    longest_task,
    needs_chromium,
    opened,
    redraws,
    shoot,
    wait_shown,
    watch_tasks,
)
from scripted import DEADLINE, Held, Scripted, free_port, wait_for

from service.server import embedded
from service.settings import Settings
from worker.executors.dask import Dask
from worker.executors.inline import Inline

pytestmark = needs_chromium

#: Diagrams of three frequencies and two dampings, thresholds up and down, in a second.
LOOP: dict[str, Any] = {
    "name": "Hysteresis",
    "gamma": {"start": 0.3, "stop": 1.4, "num": 111},
    "omega": {"start": 0.5, "stop": 0.9, "num": 9},
    "xi": [0.05, 0.1],
    "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"},
    "model": {"kind": "rigid"},
    "settle": 120,
    "observe": 30,
    "keep": 24,
}
#: Enough for a slider to have somewhere to go; `python -m benchmarks.page` measures on a million cells.
MAP: dict[str, Any] = {
    "name": "A map",
    "gamma": {"start": 0.5, "stop": 6.0, "num": 120},
    "omega": {"start": 0.4, "stop": 1.6, "num": 120},
    "xi": 0.05,
    "model": {"kind": "rigid"},
    "settle": 2,
    "observe": 8,
    "keep": 8,
}
#: No figure of a machine that others use: far above what is measured, and bad enough to be noticed.
SLOW_MS = 30_000


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, cluster: Dask) -> Iterator[str]:
    with embedded.running(Settings(data=tmp_path_factory.mktemp("data"), port=0), cluster) as address:
        yield address


def submitted(address: str, spec: dict[str, Any]) -> str:
    return str(httpx2.post(f"{address}/v1/jobs", json=spec, timeout=DEADLINE).raise_for_status().json()["id"])


def done(address: str, job: str) -> str:
    def view() -> dict[str, Any]:
        found: dict[str, Any] = httpx2.get(f"{address}/v1/jobs/{job}", timeout=DEADLINE).json()
        return found

    wait_for(lambda: view()["state"] not in ("queued", "running"))
    assert view()["state"] == "done", view()["error"]
    return job


@pytest.fixture(scope="module")
def loop(address: str) -> str:
    return done(address, submitted(address, LOOP))


def view(address: str, job: str, tab: str = "diagram", **query: Any) -> str:
    asked = "&".join(f"{name}={value}" for name, value in query.items())
    return f"{address}/#/job/{job}/{tab}?{asked}"


def colours(page: Any, selector: str = ".panel .plot canvas") -> int:
    """How many different colours a canvas has: one if nothing is drawn."""
    return int(
        page.eval_on_selector(
            selector,
            """canvas => new Set(new Uint32Array(canvas.getContext("2d")
            .getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size""",
        )
    )


def picture(page: Any) -> str:
    return str(page.eval_on_selector(".panel .plot canvas", "canvas => canvas.toDataURL()"))


# Submitting


def test_a_preset_is_submitted_and_its_progress_moves(browser: Any, tmp_path: Path):
    """Chunk by chunk, each when the bar has told of the one before."""
    held = Held()
    settings = Settings(data=tmp_path, port=0, heartbeat_seconds=0.2)
    with embedded.running(settings, held) as address, opened(browser, address) as page:
        page.get_by_role("link", name="Fig. 2").first.click()
        cost = page.locator(".cost")
        cost.filter(has_text="cells in").wait_for()  # the form is filled in
        page.get_by_label("values", exact=True).first.fill("120")
        page.get_by_label("model").select_option("rigid")
        page.get_by_label("Settle for").fill("20000")
        cost.filter(has_text=re.compile(r"120 cells in \d+ chunks · .+ of one core")).wait_for()
        shoot(page, "form")
        page.get_by_role("button", name="Compute").click()
        page.wait_for_url(re.compile("#/job/"))
        bar = page.locator("header.job .bar")
        seen: list[float] = []
        told = 0  # how many values of the bar a chunk was let go for

        def whole() -> bool:
            nonlocal told
            if _seen(bar, seen) < 100 and told < len(seen) and held.held():
                told = len(seen)
                held.let_go()
            return seen[-1] == 100

        wait_for(whole)
        assert len([percent for percent in seen if 0 < percent < 100]) >= 2
        assert seen == sorted(seen)
        wait_shown(page, omega=0.5)
        assert colours(page) > 2


def _seen(bar: Any, seen: list[float]) -> float:
    now = float(bar.get_attribute("aria-valuenow") or 0)
    if not seen or now != seen[-1]:
        seen.append(now)
    return now


def test_what_the_service_refuses_is_said_where_it_is(browser: Any, address: str):
    with opened(browser, f"{address}/#/new?figure=2", expected=("422",)) as page:
        page.locator(".cost").filter(has_text="cells in").wait_for()  # the form is filled in
        page.get_by_label("from", exact=True).first.fill("9")
        wrong = page.locator("[aria-invalid=true]")
        wrong.wait_for()
        assert wrong.get_attribute("data-field") == "gamma.start"
        assert "must not be above stop" in page.locator(".rule").inner_text()
        assert page.get_by_role("button", name="Compute").is_disabled()
        assert "marked above" in page.locator(".cost").inner_text()
        shoot(page, "form-refused")
        page.get_by_label("restitution").fill("two")
        page.locator("[data-field='model.restitution'][aria-invalid=true]").wait_for()
        page.get_by_label("from", exact=True).first.fill("1")
        page.get_by_label("restitution").fill("0.1")
        page.locator(".cost").filter(has_text="cells in").wait_for()
        assert page.locator("[aria-invalid=true]").count() == 0


def test_a_sweep_is_cancelled_resumed_and_deleted_from_the_list(browser: Any, address: str):
    endless = {**LOOP, "name": "Endless", "settle": 1_000_000, "protocol": {"kind": "rest"}}
    submitted(address, endless)
    with opened(browser, address) as page:
        row = page.locator(".jobs li").filter(has_text="Endless")
        row.get_by_role("button", name="Cancel").click()
        row.locator("[data-state=cancelled]").wait_for()
        row.get_by_role("button", name="Resume").click()
        row.get_by_role("button", name="Cancel").click()
        row.locator("[data-state=cancelled]").wait_for()
        shoot(page, "sweeps")
        row.get_by_role("button", name="Delete").click()
        page.get_by_role("button", name="Keep it").click()
        assert row.count() == 1
        row.get_by_role("button", name="Delete").click()
        page.get_by_role("dialog").get_by_role("button", name="Delete").click()
        row.wait_for(state="detached")
        page.wait_for_function("() => document.activeElement.id === 'sweeps'")  # not the top of the page


def test_what_is_typed_before_the_presets_are_there_is_kept(browser: Any, address: str):
    held: list[Any] = []

    def hold(route: Any) -> None:
        held.append(route)

    with opened(browser, "about:blank") as page:
        page.route("**/v1/figures", hold)
        page.goto(f"{address}/#/new?figure=2")
        page.get_by_label("Name").fill("typed")
        page.get_by_label("Observe").fill("77")
        page.locator(".cost", has_text="cells in").wait_for()  # of what a form is filled with before
        held[0].continue_()
        page.locator(".cost", has_text="1,001 cells").wait_for()  # as in Fig. 2
        assert page.get_by_label("Name").input_value() == "typed"
        assert page.get_by_label("Observe").input_value() == "77"
        page.get_by_label("Start from").select_option("7")  # asked for: all of it
        page.wait_for_function("() => document.querySelector('[data-field=name]').value === 'figure 7'")
        assert page.get_by_label("Observe").input_value() != "77"


def test_who_goes_back_finds_what_was_submitted(browser: Any, address: str):
    with opened(browser, f"{address}/#/new?figure=2") as page:
        page.locator(".cost", has_text="1,001 cells").wait_for()
        page.get_by_label("Name").fill("and back")
        page.get_by_label("values", exact=True).first.fill("3")
        page.get_by_role("button", name="Compute").click()
        page.wait_for_url(re.compile("#/job/"))
        page.go_back()
        page.locator(".cost", has_text="3 cells").wait_for()
        assert page.get_by_label("Name").input_value() == "and back"


def test_the_button_covers_no_field_that_has_the_focus(browser: Any, address: str):
    with opened(browser, f"{address}/#/new?figure=2", viewport={"width": 1280, "height": 600}) as page:
        page.locator(".cost", has_text="1,001 cells").wait_for()
        page.get_by_label("Name").focus()
        bottom = "document.activeElement.getBoundingClientRect().bottom"
        while page.evaluate("document.activeElement.closest('.send') === null"):
            assert page.evaluate(f"{bottom} <= document.querySelector('.send').getBoundingClientRect().top")
            page.keyboard.press("Tab")


@contextmanager
def failing(folder: Path) -> Iterator[str]:
    """The address of a service on which every sweep fails at first, in its first chunk."""
    with (
        closing(Scripted({0: [ValueError("no such spring")] * 3})) as executor,
        embedded.running(Settings(data=folder, port=0), executor) as address,
    ):
        yield address


def test_a_sweep_that_failed_says_why_on_every_tab(browser: Any, tmp_path: Path):
    with failing(tmp_path) as address, opened(browser, address) as page:
        job = submitted(address, {**LOOP, "name": "Failing"})
        page.locator(".jobs li .problem", has_text="no such spring").wait_for()
        page.goto(view(address, job))
        said = page.locator("header.job + .problem", has_text="The sweep failed: chunk 0")
        wait_shown(page, along="gamma")
        assert said.is_visible()
        shoot(page, "failed")
        page.get_by_role("link", name="Mode map").click()
        wait_shown(page, direction="up")
        assert said.is_visible()
        page.get_by_role("button", name="Resume").click()
        said.wait_for(state="hidden")
        page.locator("header.job [data-state=done]").wait_for()


def test_a_sweep_that_is_not_there_is_no_accident(browser: Any, address: str):
    with opened(browser, view(address, "nothing"), expected=("404",)) as page:
        page.get_by_role("heading", name="No such sweep").wait_for()
        page.goto(view(address, "nothing", "modes"))
        page.get_by_role("link", name="All sweeps").click()
        page.get_by_role("heading", name="A spring").wait_for()


def test_what_another_tab_did_is_seen_on_coming_back(browser: Any, tmp_path: Path):
    with failing(tmp_path) as address, opened(browser, address) as page:
        job = submitted(address, {**LOOP, "settle": 10})
        page.locator(".jobs [data-state=failed]").wait_for()
        page.goto(view(address, job))
        page.locator("header.job [data-state=failed]").wait_for()
        wait_shown(page, along="gamma")
        httpx2.post(f"{address}/v1/jobs/{job}/resume", timeout=DEADLINE).raise_for_status()
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        page.locator("header.job [data-state=done]").wait_for()


@pytest.mark.parametrize("width", [1280, 390])
def test_a_long_name_stays_in_its_place(browser: Any, address: str, width: int):
    job = submitted(address, {**LOOP, "name": "x" * 200, "settle": 1, "xi": 0.3})
    with opened(browser, address, viewport={"width": width, "height": 800}) as page:
        page.locator(".jobs li", has_text="x" * 200).wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.goto(view(address, job))
        page.locator("h1", has_text="x" * 200).wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_what_goes_wrong_for_once_is_asked_again(browser: Any, address: str, loop: str):
    def fails(route: Any) -> None:
        route.fulfill(status=503, json={"detail": "not now"})

    with opened(browser, "about:blank", expected=("503",)) as page:
        page.route("**/v1/jobs?*", fails, times=1)
        page.goto(address)
        page.locator(".problem", has_text="not now").wait_for()
        page.locator(".jobs li").first.wait_for()
        page.route(f"**/v1/jobs/{loop}", fails, times=1)
        page.goto(view(address, loop))
        page.locator(".problem", has_text="not now").wait_for()
        wait_shown(page, along="gamma")


# Looking


def test_a_slider_moves_along_the_grid_and_the_address_holds_it(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, omega=0.6, xi=0.05)) as page:
        wait_shown(page, omega=0.6, xi=0.05)
        before = picture(page)
        slider = page.get_by_role("slider").first
        assert slider.get_attribute("aria-valuetext") == "Ω = 0.6"
        slider.focus()
        page.keyboard.press("ArrowRight")
        wait_shown(page, omega=0.65)
        wait_for(lambda: picture(page) != before)
        page.wait_for_url(re.compile("omega=0.65"))
        shoot(page, "diagram")
        after = picture(page)
        page.reload()
        wait_shown(page, omega=0.65)
        wait_for(lambda: picture(page) == after)


def test_the_diagram_zooms_turns_and_leaves_out(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, omega=0.6, xi=0.05)) as page:
        wait_shown(page, along="gamma")
        whole = picture(page)
        box = page.locator(".panel .plot").bounding_box()
        page.mouse.move(box["x"] + 300, box["y"] + 100)
        page.mouse.down()
        page.mouse.move(box["x"] + 600, box["y"] + 300, steps=3)
        page.mouse.up()
        page.wait_for_url(re.compile("x0="))
        wait_for(lambda: picture(page) != whole)
        page.mouse.dblclick(box["x"] + 300, box["y"] + 100)
        page.wait_for_function("() => !location.hash.includes('x0=')")
        page.get_by_label("down", exact=True).uncheck()
        page.wait_for_url(re.compile("show=up"))
        page.get_by_label("Axis of the diagram").select_option("omega")
        wait_shown(page, along="omega")
        page.locator(".slider").first.filter(has_text="Γ =").wait_for()


def test_a_cell_that_is_clicked_is_seen_to_move(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, omega=0.6, xi=0.05, show="down")) as page:
        wait_shown(page, omega=0.6)
        box = page.locator(".panel .plot").bounding_box()
        # Γ = 0.65, between the margins of the plot: it bounces there on the way down.
        at = box["x"] + 58 + (0.65 - 0.3) / 1.1 * (box["width"] - 92), box["y"] + 150
        page.mouse.move(*at)
        readout = page.locator(".panel .readout", has_text="Γ = 0.65 · mode (1, 1)")
        readout.wait_for()
        page.mouse.click(*at)
        _phase_after(page, _phase_after(page, None))
        wait_for(lambda: colours(page, ".motion .stage") > 3)
        wait_for(lambda: colours(page, ".motion .plot canvas") > 4)
        page.locator(".motion .readout", has_text="whole flights in these 4 plate periods").wait_for()
        page.wait_for_url(re.compile("cell=.*,down"))
        page.get_by_role("button", name="Pause").click()
        shoot(page, "motion")
        still = page.locator(".motion .player").get_attribute("data-phase")
        page.wait_for_timeout(120)
        assert page.locator(".motion .player").get_attribute("data-phase") == still
        page.get_by_role("button", name="Close").click()
        assert page.locator(".motion").is_hidden()


def _phase_after(page: Any, before: str | None) -> str:
    page.wait_for_function(
        """before => {
            const { phase } = document.querySelector(".player")?.dataset ?? {};
            return phase && phase !== before;
        }""",
        arg=before,
    )
    return str(page.locator(".player").get_attribute("data-phase"))


def test_tabs_are_about_the_same_damping_and_the_same_cell(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop), reduced_motion="reduce") as page:
        wait_shown(page, along="gamma", xi=0.1)
        for tab in ("Mode map", "Thresholds"):
            page.get_by_role("link", name=tab).click()
            wait_shown(page, xi=0.1)
        page.get_by_role("link", name="Mode map").click()
        wait_shown(page, direction="up")
        page.locator(".panel .plot").focus()
        for key in ("ArrowRight", "ArrowUp", "ArrowUp", "Enter"):
            page.keyboard.press(key)
        page.wait_for_url(re.compile("cell=0.86,0.8,0.1,up"))
        page.get_by_role("link", name="Diagram").click()
        wait_shown(page, along="gamma", omega=0.8, xi=0.1)
        page.get_by_label("Axis of the diagram").select_option("omega")
        wait_shown(page, along="omega", xi=0.1)
        page.locator("[aria-valuetext='Γ = 0.86']").wait_for()


def test_a_motion_that_takes_long_is_waited_for(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, omega=0.6, xi=0.05)) as page:
        wait_shown(page, omega=0.6)
        held: list[Any] = []
        page.route("**/trajectory?*", lambda route: held.append(route))  # noqa: PLW0108 - playwright marks it
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
        page.locator(".motion .waiting", has_text="compiled").wait_for()
        shoot(page, "waiting")
        held[0].continue_()
        page.locator(".motion .player[data-phase]").wait_for()
        assert page.locator(".motion .waiting").is_hidden()


def test_what_goes_wrong_is_said_where_it_would_have_been_shown(browser: Any, address: str):
    job = done(address, submitted(address, {**LOOP, "name": "Gone", "xi": 0.2, "settle": 1}))
    with opened(browser, view(address, job, omega=0.6), expected=("404",)) as page:
        wait_shown(page, omega=0.6)
        httpx2.delete(f"{address}/v1/jobs/{job}").raise_for_status()
        slider = page.get_by_role("slider").first
        slider.focus()
        page.keyboard.press("End")
        page.locator(".panel .problem", has_text=job).wait_for()


def test_the_picture_of_the_readme(browser: Any, address: str):
    """Left in test-artefacts/page/figure-2.png."""
    gamma = {"start": 1.0, "stop": 6.0, "num": 1001}
    fig_2 = {"name": "Figure 2", "gamma": gamma, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}}
    job = done(address, submitted(address, fig_2))
    with opened(browser, view(address, job, cell="2.3,0.5,0.26,rest"), reduced_motion="reduce") as page:
        page.get_by_label("Plate periods since").fill("1.2")
        page.locator(".motion .readout", has_text="3.722, 6.285").wait_for()
        shoot(page, "figure-2")


def test_the_keyboard_reaches_every_cell(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, "modes", xi=0.05), reduced_motion="reduce") as page:
        wait_shown(page, xi=0.05)
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        first = page.locator("#said").inner_text()
        page.keyboard.press("Shift+ArrowRight")
        page.keyboard.press("ArrowUp")
        assert first.startswith("Γ = ")
        assert page.locator("#said").inner_text() != first
        shoot(page, "modes")
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Play").wait_for()
        page.keyboard.press("+")
        page.wait_for_url(re.compile("x0="))


def test_a_map_of_too_many_cells_is_thinned_until_one_looks_closer(browser: Any, tmp_path: Path):
    spec = {**MAP, "gamma": {**MAP["gamma"], "num": 60}, "omega": {**MAP["omega"], "num": 40}}
    with serving(tmp_path, 0, max_points=1000) as address:
        job = done(address, submitted(address, spec))
        with opened(browser, view(address, job, "modes")) as page:
            said = page.get_by_text("Shown: every 2nd")
            said.wait_for()
            page.locator(".panel .plot").focus()
            for _ in range(3):
                page.keyboard.press("+")
            said.wait_for(state="hidden")
            shoot(page, "modes-close")


def test_thresholds_are_those_of_the_service(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, "thresholds", xi=0.05)) as page:
        wait_shown(page, xi=0.05)
        assert colours(page) > 4
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        found = httpx2.get(f"{address}/v1/jobs/{loop}/threshold?xi=0.05", timeout=DEADLINE).json()
        said = page.locator("#said").inner_text()
        assert said.startswith(f"Ω = {found['omega'][4]:g} · Eq. 25: Γ = {found['analytic'][4]:.4g}")
        assert f"down: {found['down'][4]:.4g}" in said
        shoot(page, "thresholds")


def test_a_threshold_below_the_sweep_is_not_made_up(browser: Any, address: str):
    spec = {**LOOP, "name": "Γ–φ", "gamma": [2.3, 2.4], "omega": [0.5, 0.525], "xi": 0.26, "settle": 20}
    job = done(address, submitted(address, spec))
    with opened(browser, view(address, job, "thresholds")) as page:
        wait_shown(page, xi=0.26)
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        assert "up: 2.3 or less, where the sweep begins" in page.locator(".panel .readout").inner_text()
        page.get_by_role("link", name="Mode map").click()
        wait_shown(page, direction="up")
        with page.expect_download() as download:
            page.get_by_role("button", name="Download SVG").click()
        assert download.value.suggested_filename == "γ-φ-modes.svg"
        svg = Path(download.value.path()).read_text()
    ticks = re.findall(r'<text x="([\d.]+)"[^>]*text-anchor="end"[^>]*>(0\.\d+)<', svg)
    assert len(ticks) > 3
    # The axis's own label stands within 24 of the left edge; 13 pixels a letter's height.
    assert all(float(x) - 0.55 * 13 * len(text) >= 24 for x, text in ticks)


def test_nothing_is_offered_where_nothing_is_shown(browser: Any, address: str):
    along = {"kind": "ramp", "axis": "omega", "direction": "down"}
    job = done(address, submitted(address, {**LOOP, "name": "Along Ω", "protocol": along, "settle": 10}))
    with opened(browser, view(address, job, "thresholds"), expected=("422",)) as page:
        page.locator(".panel .problem", has_text="thresholds in gamma").wait_for()
        assert page.locator(".panel .plot").is_hidden()
        page.get_by_role("button", name="Download CSV").click()
        page.locator(".downloads", has_text="Nothing is shown here").wait_for()
        page.get_by_role("link", name="Diagram").click()
        wait_shown(page, xi=0.1)
        assert page.locator(".panel .plot").is_visible()


@pytest.mark.parametrize("tab", ["diagram", "modes", "thresholds"])
def test_what_is_shown_can_be_taken_away(browser: Any, address: str, loop: str, tab: str):
    with opened(browser, view(address, loop, tab, omega=0.6, xi=0.05)) as page:
        wait_shown(page, xi=0.05)
        assert _downloaded(page, "PNG").startswith(b"\x89PNG\r\n\x1a\n")
        assert ElementTree.fromstring(_downloaded(page, "SVG")).tag.endswith("svg")
        header, *rows = _downloaded(page, "CSV").decode().splitlines()
        assert header.startswith(("direction,gamma,omega,xi", "gamma,omega,xi", "omega,xi"))
        assert len(rows) > 5
        assert _downloaded(page, "NetCDF").startswith(b"\x89HDF")


def _downloaded(page: Any, kind: str) -> bytes:
    with page.expect_download() as download:
        page.locator(".panel").get_by_role("button", name=f"Download {kind}").click()
    assert re.fullmatch(
        rf"hysteresis-.*\.{'nc' if kind == 'NetCDF' else kind.lower()}", download.value.suggested_filename
    )
    return Path(download.value.path()).read_bytes()


# Speed


@pytest.fixture(scope="module")
def large(address: str) -> dict[str, str]:
    jobs = {name: submitted(address, spec) for name, spec in (("map", MAP), ("line", LONG_LINE))}
    return {name: done(address, job) for name, job in jobs.items()}


def test_the_first_view_is_there_at_once_and_moves(browser: Any, address: str, loop: str):
    with opened(browser, address) as page:
        page.locator(".jobs li").first.wait_for()
        assert page.evaluate("performance.now()") < SLOW_MS
        _phase_after(page, _phase_after(page, None))
        page.get_by_role("button", name="Fig. 2b").click()
        page.locator(".glimpse .readout", has_text="3.722, 6.285").wait_for()  # MODEL section 5
        shoot(page, "first")


@pytest.mark.parametrize("along", ["gamma", "omega"])
def test_a_slider_redraws_at_once(browser: Any, address: str, large: dict[str, str], along: str):
    with opened(browser, view(address, large["map"], along=along)) as page:
        wait_shown(page, along=along)
        took = redraws(page, [0, 30, 77, 119, 5, 6, 7, 8])
        note_down(**{f"redraw_ms_along_{along}": took})
        assert statistics.median(took) < SLOW_MS


def test_the_next_lines_are_fetched_before_the_slider_gets_there(
    browser: Any, address: str, large: dict[str, str]
):
    with opened(browser, view(address, large["map"])) as page:
        wait_shown(page, along="gamma")
        redraws(page, [10])
        # The first, the one that is shown, three ahead, one behind.
        page.wait_for_function(f"() => {ASKED}.length === 6")
        _, *asked = page.evaluate(ASKED)
        omegas = [float(re.findall(r"omega=([\d.]+)", url)[0]) for url in asked]
        step = (1.6 - 0.4) / 119
        expected = [0.4 + step * place for place in (10, 9, 8, 7, 11)]  # it came down from the middle
        assert omegas == pytest.approx(expected)
        redraws(page, [9, 8])
        assert page.evaluate(ASKED).count(asked[1]) == 1


ASKED = (
    "performance.getEntriesByType('resource').map((one) => one.name).filter((one) => one.includes('/line?'))"
)


def test_a_million_flights_do_not_freeze_the_page(browser: Any, address: str, large: dict[str, str]):
    with opened(browser, "about:blank") as page:
        watch_tasks(page)
        page.goto(view(address, large["line"]))
        wait_shown(page, along="gamma")
        assert colours(page) > 10
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        whole = picture(page)
        page.keyboard.press("+")
        page.wait_for_url(re.compile("x0="))
        page.wait_for_function(
            "before => document.querySelector('.panel .plot canvas').toDataURL() !== before", arg=whole
        )
        shoot(page, "million-flights")
        longest = longest_task(page)
        note_down(longest_task_ms=longest)
        assert longest < SLOW_MS
        page.evaluate(
            "setTimeout(() => { for (const end = performance.now() + 90; performance.now() < end; ); })"
        )
        page.wait_for_function("() => window.longest > 80")  # it would have been noticed


def note_down(**figures: Any) -> None:
    """Keep what was measured beside the pictures."""
    file = ROOT / "test-artefacts" / "page" / "measured.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    known = json.loads(file.read_text()) if file.exists() else {}
    draft = file.with_suffix(f".{os.getpid()}")  # nobody reads half of it
    draft.write_text(json.dumps(known | figures, indent=1))
    draft.replace(file)


# Everybody


CELL = "xi=0.05&omega=0.6&cell=0.65,0.6,0.05,down"
TABS = ("diagram", "modes", "thresholds", "details")
VIEWS = ("", "#/new?figure=9", *(f"#/job/JOB/{tab}?{CELL}" for tab in TABS))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(browser: Any, address: str, loop: str, scheme: str):
    axe = (ROOT / "tests" / "vendor" / "axe.min.js").read_text()
    with opened(browser, "about:blank", color_scheme=scheme, reduced_motion="reduce") as page:
        page.add_init_script(axe)
        for one in VIEWS:
            page.goto(f"{address}/{one.replace('JOB', loop)}")
            _settled(page, one)
            found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")["violations"]
            serious = [
                (rule["id"], rule["nodes"][0]["html"])
                for rule in found
                if rule["impact"] in ("serious", "critical")
            ]
            assert serious == [], one


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_fits_a_phone(browser: Any, address: str, loop: str, scheme: str):
    phone = {"viewport": {"width": 375, "height": 740}, "has_touch": True, "color_scheme": scheme}
    with opened(browser, address, reduced_motion="reduce", **phone) as page:
        for number, one in enumerate(VIEWS):
            page.goto(f"{address}/{one.replace('JOB', loop)}")
            _settled(page, one)
            assert page.evaluate("document.documentElement.scrollWidth") <= 375, one
            shoot(page, f"phone-{scheme}-{number}")


def _settled(page: Any, place: str) -> None:
    """Until a view shows all it has to show."""
    if "/new" in place:
        page.locator(".cost", has_text="cells in").wait_for()
        return
    page.locator(".player[data-phase]").wait_for()
    if "/job/" not in place:
        page.locator(".jobs li").first.wait_for()
    elif "/details" not in place:
        page.locator(".panel .plot[data-shows]").wait_for()


# A service that goes away, and one that asks who is there


@contextmanager
def serving(folder: Path, port: int, **given: Any) -> Iterator[str]:
    with ExitStack() as stack:
        executor = Inline()
        stack.callback(executor.close)
        yield stack.enter_context(embedded.running(Settings(data=folder, port=port, **given), executor))


def test_a_service_that_is_lost_comes_back(browser: Any, tmp_path: Path):
    port = free_port()
    with ExitStack() as running:
        address = running.enter_context(serving(tmp_path, port))
        with opened(browser, f"{address}/#/new?figure=2", expected=("net::ERR_",)) as page:
            page.locator(".cost", has_text="cells in").wait_for()
            running.close()
            page.get_by_label("Name").fill("kept")
            banner = page.locator("#lost")
            banner.wait_for()
            banner.filter(has_text="does not answer").wait_for()
            shoot(page, "lost")
            running.enter_context(serving(tmp_path, port))
            banner.wait_for(state="hidden")
            page.locator(".cost", has_text="cells in").wait_for()
            assert page.get_by_label("Name").input_value() == "kept"


def test_a_service_that_wants_a_token_is_given_one(browser: Any, tmp_path: Path):
    token = "a-token-of-the-tests"
    with serving(tmp_path, 0, token=token) as address, opened(browser, address, expected=("401",)) as page:
        dialog = page.get_by_role("dialog", name="Token")
        dialog.get_by_label("Token").fill(token)
        shoot(page, "token")
        dialog.get_by_role("button").click()
        page.get_by_text("None yet").wait_for()
