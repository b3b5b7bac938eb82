"""The page in a real Chromium, served by a real service."""

import json
import math
import os
import re
import webbrowser
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from browser import (
    DROP,
    LONG_LINE,
    ROOT,
    download,
    longest_task,
    needs_chromium,
    open_tab,
    opened,
    picture,
    reopen,
    screenshot,
    table_of,
    wait_shown,
    watch_tasks,
)
from click.testing import CliRunner
from PIL import Image
from scripted import DEADLINE, Held, Scripted, free_port, wait_for
from served import computing_at, done, service_at
from studies import spec_of
from toy_view import add_stored_variable

from service.background import InThisProcess
from service.cli.main import main
from service.client import Client
from service.server import embedded

pytestmark = needs_chromium

#: Diagrams at nine frequencies and two dampings, thresholds up and down, computed in a second.
LOOP = spec_of(
    (0.3, 1.4, 111), (0.5, 0.9, 9), [0.05, 0.1], name="Hysteresis", ramp="both", window=(120, 30, 24)
)
#: Far above what is measured even on a loaded machine; slower than this is a defect.
SLOW_MS = 30_000


def submitted(address: str, spec: dict[str, Any]) -> str:
    return str(httpx2.post(f"{address}/v1/jobs", json=spec, timeout=DEADLINE).raise_for_status().json()["id"])


@pytest.fixture(scope="module")
def loop(address: str) -> str:
    return done(address, LOOP)


def view(address: str, job: str, tab: str = "diagram", **query: Any) -> str:
    parameters = "&".join(f"{name}={value}" for name, value in query.items())
    return f"{address}/#/job/{job}/{tab}?{parameters}"


@pytest.fixture
def showing(browser: Any, address: str, loop: str) -> Any:
    """Opens a view of `loop`, with options of the browser, and waits until its plot shows the spring."""

    @contextmanager
    def showing(tab: str = "diagram", options: dict[str, Any] | None = None, **query: Any) -> Iterator[Any]:
        with opened(browser, view(address, loop, tab, **query), **options or {}) as page:
            wait_shown(page, **{name: query[name] for name in ("omega", "xi") if name in query})
            yield page

    return showing


def colours(page: Any, selector: str = ".panel .plot canvas") -> int:
    """The number of different colours on a canvas: one if nothing is drawn."""
    return int(
        page.eval_on_selector(selector, "canvas => new Set(new Uint32Array(pixels(canvas).data.buffer)).size")
    )


# The form


def test_a_preset_is_submitted_and_its_progress_moves(browser: Any, tmp_path: Path):
    """Each chunk is released once the bar shows the one before."""
    held = Held()
    with service_at(tmp_path, held) as address, opened(browser, address) as page:
        page.get_by_role("link", name="New study").click()
        page.get_by_label("Start from").select_option("2")
        cost = page.locator(".cost")
        cost.filter(has_text="cells in").wait_for()  # the form is filled in
        page.locator("[data-field='gamma.num']").fill("120")
        page.get_by_label("contact model").select_option("rigid")
        efforts = page.locator("select[data-field=effort] option").all_inner_texts()
        assert efforts == ["as in Recording", "draft", "standard", "thorough"]
        page.locator("summary", has_text="Recording").click()
        page.locator("[data-field=settle]").fill("20000")
        cost.filter(has_text=re.compile(r"120 cells in \d+ chunks · about .+ on 2 workers")).wait_for()
        page.get_by_role("button", name="Compute").click()
        page.wait_for_url(re.compile("#/job/"))
        bar = page.locator("#bar .bar")
        seen: list[float] = []
        released = 0  # the number of values of the bar for which a chunk was released

        def whole() -> bool:
            nonlocal released
            if _seen(bar, seen) < 100 and released < len(seen) and held.held():
                released = len(seen)
                held.let_go()
            return seen[-1] == 100

        wait_for(whole)
        assert len([percent for percent in seen if 0 < percent < 100]) >= 2
        assert seen == sorted(seen)
        wait_shown(page, omega=0.5)
        assert colours(page) > 2
        reopen(page, view(address, submitted(address, LOOP), "modes"))
        texts = page.locator(".panel .plot .texts", has_text="not computed yet: the colour of the nearest")
        texts.wait_for(state="attached")  # in the PNG too


def _seen(bar: Any, seen: list[float]) -> float:
    now = float(bar.get_attribute("value") or 0)
    if not seen or now != seen[-1]:
        seen.append(now)
    return now


def test_a_broken_rule_is_shown_at_its_field(browser: Any, address: str):
    with opened(browser, f"{address}/#/new?figure=2", expected=("422",)) as page:
        page.locator(".cost").filter(has_text="cells in").wait_for()  # the form is filled in
        page.get_by_label("start", exact=True).first.fill("9")
        invalid = page.locator("[aria-invalid=true]")
        invalid.wait_for()
        assert invalid.get_attribute("data-field") == "gamma.start"
        assert page.get_by_role("alert").inner_text() == page.locator(".error").inner_text()
        assert "must not be above stop: swap the two" in page.locator(".error").inner_text()
        assert page.get_by_role("button", name="Compute").is_disabled()
        assert "see the messages above" in page.locator(".cost").inner_text()
        page.get_by_label("restitution").fill("two")
        page.locator("[data-field='model.restitution'][aria-invalid=true]").wait_for()
        assert page.locator(".error").last.inner_text() == "must be a number, not text 'two'"
        page.get_by_label("restitution").fill("0,1")
        page.locator(".error", has_text="write a decimal point, not a comma: 0.1").wait_for()
        page.locator("[data-field='xi']").fill("0,26")
        page.locator(".error", has_text="write 0.26, or 0, 26 for two values").wait_for()
        page.locator("[data-field='xi']").fill("2e-1,0.26")
        page.locator(".parsed", has_text="2 values: 0.2, 0.26").wait_for()
        page.locator("[data-field='xi']").fill("0.25,0.26")
        page.locator(".parsed", has_text="2 values: 0.25, 0.26").wait_for()
        page.get_by_label("start", exact=True).first.fill("1")
        page.get_by_label("restitution").fill("0.1")
        for text, rule in (
            ("5.5", "must be a whole number: 5 or 6, not 5.5"),
            ("", "is empty: type a number"),
            ("1,001", "must be a whole number, not text '1,001'"),
            ("0x10", "must be a whole number, not text '0x10'"),
        ):
            page.get_by_label("number of values").first.fill(text)
            page.locator(".error", has_text=rule).wait_for()
            assert page.locator(".error").inner_text() == rule
        page.get_by_label("number of values").first.fill("120")
        page.locator(".cost").filter(has_text="cells in").wait_for()
        assert page.locator("[aria-invalid=true]").count() == 0


def test_a_study_is_submitted_before_its_cost_is_known(browser: Any, address: str):
    with opened(browser, address) as page:
        page.route("**/v1/jobs?validate_only=true", lambda route: None)  # it is not answered
        page.goto(f"{address}/#/new?gamma=0.1&omega=0.5&xi=0.26")
        page.locator("[data-field=name]").fill("Not estimated")
        page.get_by_role("button", name="Compute", exact=True).press("Enter")
        page.locator("#bar h1", has_text="Not estimated").wait_for()


def test_the_form_compares_what_a_time_buys_and_takes_a_setting(browser: Any, address: str):
    with opened(browser, f"{address}/#/new?figure=2") as page:
        page.get_by_label("number of values").first.fill("120")
        page.get_by_label("contact model").select_option("rigid")
        page.get_by_text("Plan for a given time").click()
        page.get_by_label("Time", exact=True).fill("soon")
        page.get_by_role("button", name="Compare settings").click()
        page.get_by_text("The time must be such as 90s, 5m or 1h.").wait_for()
        page.get_by_label("Time", exact=True).fill("5m")
        page.get_by_role("button", name="Compare settings").click()
        page.locator("tr .recommended").wait_for()
        coarsest = page.locator("tbody tr").last
        cells = coarsest.locator("td").nth(1).inner_text()
        assert 1 <= int(cells) < 120
        coarsest.get_by_role("button", name="Use draft").click()
        page.locator(".cost").filter(has_text=f"{cells} cells").wait_for()
        page.get_by_label("Time", exact=True).fill("0.000001s")
        page.get_by_role("button", name="Compare settings").click()
        page.get_by_text("Note: no setting judged at fresh points surely keeps to a budget").wait_for()


def test_the_page_shows_the_finest_level_within_a_time(browser: Any, address: str, loop: str):
    """The kernel is that of `loop`: with its compilation, a slow machine had no time for a second level."""
    with opened(browser, f"{address}/#/new", expected=("422", "429")) as page:
        page.get_by_label("contact model").select_option("rigid")
        page.get_by_label("given as").nth(1).select_option("a range")
        fields = {"gamma.num": 300, "omega.start": 0.3, "omega.stop": 1.5, "omega.num": 100}
        for name, value in fields.items():
            page.locator(f"[data-field='{name}']").fill(str(value))
        full = {"status": 429, "json": {"detail": "the queue is full"}}
        page.route(re.compile(r"/v1/jobs\?$"), lambda route: route.fulfill(**full))
        page.get_by_role("button", name="Compute", exact=True).press("Enter")
        page.locator(".problem", has_text="the queue is full").wait_for()
        page.locator("button.button:focus", has_text="Compute").wait_for()
        page.get_by_text("Plan for a given time").click()
        page.get_by_label("Time", exact=True).fill("0.000001s")
        page.get_by_role("button", name="Compute within this time").click()
        page.locator("details .problem", has_text="budget: was over before the first level").wait_for()
        page.get_by_label("Time", exact=True).fill("60s")
        with page.expect_response(lambda answer: "budget=" in answer.url) as posted:
            page.get_by_role("button", name="Compute within this time").click()
        coarsest = view(address, posted.value.json()["id"])
        page.locator(".notice", has_text=re.compile("s left")).wait_for()
        page.locator(".notice", has_text=re.compile("How wrong|no audit")).wait_for()
        assert posted.value.json()["id"] not in page.url
        cells = page.locator(".amount").inner_text()
        page.goto(coarsest)  # opened on purpose: it stays
        page.get_by_text("Show the finest level of its time").click()
        page.locator(".amount", has_text=cells).wait_for()
        for _ in range(3):
            page.go_back()
        page.locator(".cost", has_text="30,000 cells").wait_for()  # of what was submitted, not of a level


def test_a_level_that_is_computed_is_shown_until_it_is_done(browser: Any, address: str, loop: str):
    budget = {"id": "b", "doing": "81 cells", "computing": loop, "answer": "0" * 32, "seconds_left": 9}
    job = httpx2.get(f"{address}/v1/jobs/{loop}", timeout=DEADLINE).json()
    with opened(browser, address) as page:
        answer = {"json": job | {"budget": budget | {"over": False, "error": None}}}
        page.route(f"**/v1/jobs/{loop}", lambda route: route.fulfill(**answer))
        page.goto(view(address, loop))
        page.locator(".notice", has_text="81 cells, 9 s left").wait_for()
        with page.expect_request(f"**/v1/jobs/{loop}"):  # again: the page is not that of the answer
            pass


#: Kinds of study as the form names them, what is typed into which field, and what is then submitted.
STUDIES = (
    ("Sweep", {"gamma.num": "5"}, {"protocol": {"kind": "rest"}}),
    ("Ramp", {"gamma.num": "5"}, {"protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}}),
    ("Adaptive", {"gamma.num": "16", "omega.num": "16", "refine.coarsest": "8"}, {"refine": {"by": "mode"}}),
    ("Lyapunov", {"gamma.num": "4", "settle": "20", "observe": "20"}, {"exponents": 1}),
    ("Basins", {"protocol.rows": "4", "protocol.columns": "4"}, {"protocol": {"kind": "basin", "rows": 4}}),
    ("Multistability", {"gamma.num": "2"}, {"protocol": {"kind": "multistability"}}),
    ("Cycles", {"modes": "1-1", "points": "20"}, {"modes": ["1-1"], "points": 20}),
)


@pytest.mark.parametrize(("title", "typed", "expected"), STUDIES, ids=[title for title, *_ in STUDIES])
def test_any_study_is_submitted_by_the_keyboard_alone(
    browser: Any, address: str, title: str, typed: dict[str, str], expected: dict[str, Any]
):
    def tab_to(selector: str) -> None:
        for _ in range(60):
            page.keyboard.press("Tab")
            if page.evaluate("selector => document.activeElement.matches(selector)", selector):
                return
        raise AssertionError(f"{selector} is not reached")

    with opened(browser, f"{address}/#/new", expected=("422",)) as page:
        page.locator(".cost", has_text="cells in").wait_for()
        tab_to(".preset label:first-child select")
        page.keyboard.type(title)
        tab_to("[data-field=name]")
        page.keyboard.type(f"{title} typed")
        for field, value in typed.items():
            if field in ("settle", "points"):
                tab_to("summary:has(small)")
                page.keyboard.press("Enter")
            tab_to(f"[data-field='{field}']")
            page.keyboard.press("Control+A")
            page.keyboard.type(value)
        page.locator("button.button:enabled", has_text="Compute").wait_for()
        tab_to("button.button")
        page.keyboard.press("Enter")
        page.locator("#bar h1", has_text=f"{title} typed").wait_for()
        (job,) = re.findall("/job/([0-9a-f]+)", page.url)
        page.locator("#bar").get_by_role("link", name="Duplicate").click()
        page.locator(".cost", has_text="chunk").wait_for()
        assert page.get_by_label("Study").locator(":checked").inner_text().startswith(title)
        page.get_by_text("Copy as Python").click()
        page.get_by_label("Language").select_option("JSON")
        again = json.loads(page.locator("details pre").text_content())
    submitted = httpx2.get(f"{address}/v1/jobs/{job}", timeout=DEADLINE).json()["spec"]
    for name, value in (*expected.items(), *again.items()):
        assert submitted[name] == value or submitted[name].items() >= value.items()


def test_a_kind_of_study_begins_with_what_the_kind_before_lacked(browser: Any, address: str):
    """A study of cycles has no Γ: an edited one is not kept over it, and not left empty."""
    with opened(browser, f"{address}/#/new") as page:
        page.locator("[data-field='gamma.num']").fill("30")
        for kind in ("orbits", "rest"):
            page.get_by_label("Study").select_option(kind)
        page.locator("[data-field='gamma.num']").wait_for()


def test_another_kind_of_study_keeps_the_spring_that_was_explored(browser: Any, address: str):
    with opened(browser, f"{address}/#/new?omega=0.6&xi=0.05") as page:
        page.locator(".cost", has_text="cells in").wait_for()
        page.get_by_label("Study").select_option("ramp")
        spring = {"omega": "0.6", "xi": "0.05", "model.kind": "rigid"}
        for field, value in spring.items():
            assert page.locator(f"[data-field='{field}']").input_value() == value


def test_any_study_is_pasted_or_dropped_as_a_file(browser: Any, address: str):
    orbits = {"name": "dropped", "protocol": {"kind": "orbits"}, "omega": [0.61], "xi": 0.05, "points": 20}
    with opened(browser, address, expected=("400", "422")) as page:
        page.get_by_role("heading", name="Sweeps").wait_for()
        page.evaluate(DROP, ["spec.toml", "gamma = 1"])
        refusal = page.get_by_text("the text is not JSON at line 1, column 1")
        refusal.wait_for()
        assert refusal.bounding_box()["y"] < page.viewport_size["height"]
        page.get_by_label("Specification as JSON").fill(json.dumps(orbits | {"points": "many"}))
        page.locator(".problem", has_text="points").wait_for()
        page.get_by_label("Specification as JSON").fill(json.dumps(orbits | {"omega": [0.61, 0.62]}))
        page.locator(".cost", has_text="2 cells in").wait_for()
        assert page.evaluate("document.activeElement.tagName") == "TEXTAREA"  # who types may go on
        page.evaluate(DROP, ["spec.json", json.dumps(orbits)])
        page.locator(".cost", has_text="1 cell in").wait_for()
        page.get_by_role("button", name="Compute").click()
        page.locator("#bar h1", has_text="dropped").wait_for()
        page.once("dialog", lambda dialog: dialog.accept("called otherwise"))
        page.get_by_role("button", name="Rename").click()
        page.locator("#bar h1", has_text="called otherwise").wait_for()
        wait_shown(page, omega=0.61)
        assert download(page.get_by_role("button", name="Download PNG")).name == "called-otherwise-cycles.png"


def test_a_contact_model_that_the_page_does_not_know_is_in_the_form(browser: Any, address: str):
    """The form needs no change for a new model: it is described by the API's schema."""

    def add_toy(route: Any) -> None:
        document = route.fetch().json()
        schemas = document["components"]["schemas"]
        schemas["Toy"] = {
            "description": "Toy contact; of no use.",
            "properties": {
                "kind": {"const": "toy"},
                "bounciness": {"title": "Bounciness", "type": "number", "default": 0.25},
                "mood": {"title": "Mood", "enum": ["good", "bad"], "default": "bad"},
                "sticky": {"title": "Sticky", "type": "boolean", "default": True},
            },
        }
        schemas["SweepSpec"]["properties"]["model"]["oneOf"].append({"$ref": "#/components/schemas/Toy"})
        route.fulfill(json=document)

    with opened(browser, "about:blank", expected=("422",)) as page:
        page.route("**/openapi.json", add_toy)
        page.goto(f"{address}/#/new")
        page.get_by_label("contact model").select_option(label="toy: toy contact")
        assert page.get_by_label("bounciness").get_attribute("placeholder") == "0.25"
        page.get_by_label("bounciness").fill("0.5")
        page.locator(".error", has_text="toy").wait_for()
        page.get_by_text("Copy as Python").click()
        page.get_by_label("Language").select_option("JSON")
        specification = json.loads(page.locator("details pre").text_content())
        expected = {"kind": "toy", "bounciness": 0.5}
        assert specification["model"] == expected


def test_a_sweep_is_cancelled_resumed_and_deleted_from_the_list(browser: Any, address: str):
    endless = {**LOOP, "name": "Endless", "settle": 1_000_000, "protocol": {"kind": "rest"}}
    job = submitted(address, endless)
    with opened(browser, address, expected=("404",)) as page, Client(address) as client:
        row = page.locator(".jobs li").filter(has_text="Endless")
        row.get_by_role("button", name="Cancel").click()
        row.locator("[data-state=cancelled]").wait_for()
        assert page.locator("#status").inner_text() == "Endless: cancel requested."
        row.get_by_role("button", name="Resume").click()
        row.get_by_role("button", name="Cancel").click()
        row.locator("[data-state=cancelled]").wait_for()
        page.once("dialog", lambda dialog: (client.job(job).delete(), dialog.accept()))  # elsewhere, too
        row.get_by_role("button", name="Delete").click()
        row.wait_for(state="detached")
        page.wait_for_function("() => document.activeElement.id === 'sweeps'")


def test_the_page_of_a_sweep_shows_what_is_done_to_it_elsewhere(browser: Any, address: str):
    endless = {**LOOP, "name": "Elsewhere", "settle": 1_000_000, "protocol": {"kind": "rest"}}
    job = submitted(address, endless)
    with (
        opened(browser, view(address, job), expected=("404",), hurried=True) as page,
        Client(address) as client,
    ):
        shown = client.job(job)
        page.locator("#bar [data-state=running]").wait_for()
        for change, state in (
            (shown.cancel, "cancelled"),
            (shown.resume, "running"),
            (shown.cancel, "cancelled"),
        ):
            change()
            page.locator(f"#bar [data-state={state}]").wait_for()
            page.locator("#status", has_text=f"The sweep is {state}.").wait_for(state="attached")
        shown.delete()
        page.get_by_role("heading", name="No such sweep").wait_for()


#: The colours across the middle of a plot, without its margins.
_ACROSS = """canvas => {
    const { data, width, height } = pixels(canvas);
    const row = new Uint32Array(data.buffer).subarray((height >> 1) * width, ((height >> 1) + 1) * width);
    return [...new Set(row.slice(0.1 * width, 0.9 * width))];
}"""


def test_a_running_map_has_everywhere_the_colour_of_a_computed_cell(browser: Any, tmp_path: Path):
    held = Held()
    with service_at(tmp_path, held) as address:
        job = submitted(address, spec_of((2.0, 6.0, 60), (0.5, 0.9, 4), 0.1, window=(3000, 64, 8)))
        with opened(browser, view(address, job, "modes")) as page:
            page.get_by_text("No cell is computed yet").wait_for()
            [missing] = page.eval_on_selector(".panel .plot canvas", _ACROSS)
            held.let_go()
            page.get_by_text("No cell is computed yet").wait_for(state="hidden")
            assert missing not in page.eval_on_selector(".panel .plot canvas", _ACROSS)


def test_a_comparison_follows_what_is_computed(browser: Any, tmp_path: Path):
    held = Held()
    with service_at(tmp_path, held) as address:
        jobs = [submitted(address, spec_of((1.2, 3.0, 20), 0.5, xi, name=str(xi))) for xi in (0.1, 0.2)]
        with opened(browser, f"{address}/#/compare?jobs={','.join(jobs)}") as page:
            page.locator(".compared li", has_text="running, 0 % of 20 cells").first.wait_for()
            page.locator(".panel .plot[data-shown*='\"complete\":false']").wait_for()
            done = page.locator(".panel .plot[data-shown*='\"complete\":true']")
            held.let_go_until(lambda: done.count() == 1)
            page.locator(".compared li", has_text="running").wait_for(state="detached")
            assert page.locator("#slider-xi").count() == 0  # each has one ξ


def test_the_error_of_a_failed_sweep_is_shown_on_every_tab(browser: Any, tmp_path: Path):
    with (
        closing(Scripted({0: [ValueError("no such spring")] * 3})) as executor,
        service_at(tmp_path, executor) as address,
        opened(browser, address) as page,
    ):
        job = submitted(address, {**LOOP, "name": "Failing"})
        page.locator(".jobs li .problem", has_text="no such spring").wait_for()
        page.goto(view(address, job))
        error = page.locator("header.job .problem", has_text="The sweep failed: chunk 0")
        wait_shown(page, along="gamma")
        assert error.is_visible()
        open_tab(page, "Mode map")
        wait_shown(page, direction="up")
        assert error.is_visible()
        page.get_by_role("button", name="Resume").click()
        error.wait_for(state="hidden")
        page.locator("#bar [data-state=done]").wait_for()


#: As when the tab is shown again.
_RETURN = "document.dispatchEvent(new Event('visibilitychange'))"


def test_an_unknown_sweep_is_reported(browser: Any, address: str):
    with opened(browser, view(address, "nothing"), expected=("404",)) as page:
        page.get_by_role("heading", name="No such sweep").wait_for()
        page.get_by_role("link", name="New", exact=True).click()
        page.goto(f"{address}/#/new?from=nothing")  # the form has the default values
        page.locator(".problem", has_text="no job has the id 'nothing'").wait_for()
        page.locator(".cost", has_text="cells in").wait_for()
        spec = LOOP | {"settle": 1, "xi": 0.32}
        job = done(address, spec)
        page.goto(view(address, job))
        wait_shown(page, xi=0.32)
        httpx2.delete(f"{address}/v1/jobs/{job}", timeout=DEADLINE).raise_for_status()
        page.evaluate(_RETURN)
        page.get_by_role("heading", name="No such sweep").wait_for()
        assert done(address, spec) == job
        wait_shown(page, xi=0.32)


def test_a_name_is_shown_as_it_was_typed(browser: Any, address: str):
    name = "γ  near the fold,  ξ = .3"
    job = submitted(address, {**LOOP, "name": name, "settle": 1, "xi": 0.31})
    with opened(browser, address) as page:
        page.locator(".jobs li h2", has_text="near the fold").wait_for()
        assert page.locator(".jobs li h2", has_text="near the fold").inner_text() == name
        page.goto(view(address, job))
        page.locator("#bar h1", has_text="near the fold").wait_for()
        assert page.locator("#bar h1").inner_text() == name


@pytest.mark.parametrize(("asked", "status"), [("2", 429), ("2", 503), ("1e300", 429)])
def test_the_page_waits_for_a_busy_service_and_says_so(
    browser: Any, address: str, loop: str, asked: str, status: int
):
    """Also where a proxy holds its requests back (503)."""
    kind = "application/problem+json" if status == 429 else "text/html"
    busy = {"status": status, "body": "{}", "headers": {"Retry-After": asked, "Content-Type": kind}}
    with opened(browser, "about:blank", expected=(str(status),), hurried=asked == "2") as page:
        page.route("**/diagram?*", lambda route: route.fulfill(**busy), times=2 if asked == "2" else 1)
        page.goto(view(address, loop))
        page.locator("#busy", has_text="The service is busy").wait_for()
        if asked == "2":
            wait_shown(page, along="gamma")
            page.locator("#busy").wait_for(state="hidden")
            assert page.locator(".problem:visible").count() == 0


def test_the_page_says_why_nothing_is_computed_while_an_answer_is_awaited(
    browser: Any, address: str, loop: str
):
    answer = {"status": 202, "json": {"notice": "no workers yet"}}
    with opened(browser, "about:blank", hurried=True) as page:
        page.route("**/diagram?*", lambda route: route.fulfill(**answer), times=2)
        page.goto(view(address, loop))
        page.locator("#busy", has_text="Nothing is computed now: no workers yet.").wait_for()
        wait_shown(page, along="gamma")
        page.locator("#busy").wait_for(state="hidden")


def test_the_page_works_below_a_path_of_a_proxy(browser: Any, address: str, loop: str):
    below = f"{address}/lab"
    with opened(browser, "about:blank") as page:
        page.route(f"{address}/**", lambda route: route.abort())
        page.route(f"{below}/**", lambda route: route.continue_(url=route.request.url.replace("/lab/", "/")))
        page.goto(view(below, loop))
        wait_shown(page, along="gamma")
        open_tab(page, "Details")
        page.get_by_text(f'xarray.open_zarr("{below}/v1/jobs/{loop}/zarr")').wait_for()
        page.get_by_role("link", name="API").click()
        page.get_by_role("link", name="Explore").click()  # from the documentation
        page.get_by_role("heading", name="Explore a spring").wait_for()
        assert page.url.startswith(f"{below}/#/explore")


def test_an_error_is_shown_until_the_service_answers_again(browser: Any, address: str, loop: str):
    failing = {"status": 500, "json": {"detail": "a disk is full"}}
    with opened(browser, view(address, loop), expected=("500",), hurried=True) as page:
        wait_shown(page, along="gamma")
        page.route(f"**/v1/jobs/{loop}", lambda route: route.fulfill(**failing), times=1)
        page.evaluate(_RETURN)
        problem = page.locator("header.job .problem", has_text="a disk is full")
        problem.wait_for()
        problem.wait_for(state="hidden")


# The views of a sweep


def test_a_slider_follows_the_grid_and_is_kept_in_the_address(showing: Any):
    with showing(omega=0.6, xi=0.05) as page:
        before = picture(page)
        slider = page.get_by_role("slider").first
        assert slider.get_attribute("aria-valuetext") == "Ω = 0.6"
        slider.focus()
        page.keyboard.press("ArrowRight")
        wait_shown(page, omega=0.65)
        wait_for(lambda: picture(page) != before)
        page.wait_for_url(re.compile("omega=0.65"))
        after = picture(page)
        page.reload()
        wait_shown(page, omega=0.65)
        wait_for(lambda: picture(page) == after)


#: Two turns of the wheel in one task: on a slow machine those of Playwright are not one gesture.
_TURN_TWICE = """plot => {
    const { left, top } = plot.getBoundingClientRect();
    for (const deltaY of [-400, -400])
        plot.dispatchEvent(new WheelEvent("wheel", {
            deltaY, clientX: left + 400, clientY: top + 300, bubbles: true, cancelable: true,
        }));
}"""


#: Back, a step before the page hears of it, and Back before anything else happens.
_BACK_STEP_AND_BACK = """async (plot) => {
    const back = async () => {
        const gone = new Promise((done) => {
            addEventListener("popstate", done, { once: true });
            setTimeout(done, 5000);
        });
        history.back();
        await gone;
    };
    await back();
    plot.dispatchEvent(new KeyboardEvent("keydown", { key: "+", bubbles: true, cancelable: true }));
    await back();
}"""


def test_the_diagram_zooms_changes_axis_and_hides_a_ramp(browser: Any, address: str, loop: str):
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
        address = page.url
        page.locator(".panel .plot").evaluate(_TURN_TWICE)
        page.wait_for_url(re.compile("x0=.*y1="))
        page.locator(".panel .plot").evaluate(_BACK_STEP_AND_BACK)
        page.wait_for_url(address)
        page.go_forward()
        page.wait_for_url(re.compile("x0="))
        page.go_back()
        page.wait_for_url(address)
        page.get_by_label("Ramp").select_option("up")
        page.wait_for_url(re.compile("show=up"))
        page.get_by_label("Axis of the diagram").select_option("omega")
        wait_shown(page, along="omega")
        page.locator(".slider").first.filter(has_text="Γ =").wait_for()


def test_a_shared_file_is_the_page_without_a_service(browser: Any, address: str, loop: str, tmp_path: Path):
    file = tmp_path / "shared.html"
    assert CliRunner().invoke(main, ["share", loop, "-o", str(file), "--url", address]).exit_code == 0
    shown = f"{file.as_uri()}#/job/{loop}/diagram?xi=0.05"
    with opened(browser, shown, offline=True, viewport={"width": 1280, "height": 800}) as page:
        wait_shown(page, xi=0.05)
        page.get_by_label("Ramp").select_option("up")
        page.get_by_label("Value of Ω").fill("0.6")
        page.keyboard.press("Enter")
        wait_shown(page, omega=0.6)
        assert colours(page) > 2
        open_tab(page, "Mode map")
        page.locator(".legend", has_text="(1, 1)").wait_for()
        open_tab(page, "Thresholds")
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        page.locator(".panel .readout", has_text="ramp down: 0.").wait_for()
        assert "trajectory" not in page.locator(".panel .plot").get_attribute("aria-label")
        open_tab(page, "Details")
        page.locator("tr", has_text="How to cite").get_by_text("Physica D").wait_for()
        page.get_by_label("Language").select_option("Python")
        page.locator(".snippets pre", has_text='Client("http://127.0.0.1:8000")').wait_for()  # not file://
        page.get_by_role("link", name="Bouncing spring").click()  # there is no list
        wait_shown(page, xi=0.1)
    damaged = tmp_path / "damaged.html"
    damaged.write_text(re.sub(r'("data": ".{200}).', r"\1*", file.read_text()))
    with opened(browser, damaged.as_uri(), offline=True) as page:
        page.locator(".problem", has_text="This file is damaged").wait_for()
        page.locator("#offline").wait_for(state="hidden")
    with opened(browser, file.as_uri(), offline=True, java_script_enabled=False) as page:
        assert page.locator("img[alt='Bifurcation diagram']").bounding_box()["width"] > 300
        page.locator("th", has_text="kernel_version").wait_for()
    with opened(browser, address, expected=("422",)) as page:
        page.get_by_role("heading", name="Sweeps").wait_for()
        page.evaluate(DROP, ["foreign.html", "<html>"])
        page.locator(".problem", has_text="bounce share wrote").wait_for()
        page.get_by_label("Or choose it").set_input_files(file)
        page.wait_for_url(f"**/job/{loop}**")


def test_the_plot_ends_above_a_cell_that_is_shown_and_stays_in_its_corner(showing: Any):
    with showing(options={"viewport": {"width": 1280, "height": 800}}, omega=0.6, xi=0.05) as page:
        plot = page.locator(".panel .plot")
        box = plot.bounding_box()
        assert box["y"] < 140
        assert box["width"] > 900
        assert box["height"] > 600
        assert box["y"] + box["height"] < 800  # all of it is seen
        for across, motion in ((0.1, "No two flights in a row"), (0.5, "plate periods")):
            plot.click(position={"x": across * box["width"], "y": 300})
            page.locator(".trajectory").get_by_text(motion).first.wait_for()
            drawer = page.locator(".trajectory").bounding_box()
            for seen in (
                plot,
                *(page.locator(f".panel .{part}") for part in ("readout", "legend")),
            ):  # nothing of them is covered
                assert seen.bounding_box()["y"] + seen.bounding_box()["height"] < drawer["y"]
        side = ("x", "y", "width")
        assert [plot.bounding_box()[name] for name in side] == [box[name] for name in side]
        for figure in page.locator(".trajectory .plot").all():
            drawn = figure.bounding_box()
            assert drawn["y"] + drawn["height"] < 800
        page.get_by_role("button", name="Prove this cycle").click()
        page.locator(".trajectory li", has_text=" rad").first.wait_for()
        page.keyboard.press("Escape")
        page.locator(".trajectory").wait_for(state="hidden")
        page.get_by_text("Table of what is shown").click()
        page.get_by_role("columnheader", name="mode").wait_for()
        assert plot.bounding_box() == box


def test_a_plot_is_seen_whole_whatever_stands_above_and_below_it(showing: Any):
    size = {"width": 1024, "height": 768}  # what is above wraps, and a motion is higher
    with showing(options={"viewport": size}, omega=0.6, xi=0.05) as page:
        plot = page.locator(".panel .plot")
        box = plot.bounding_box()
        assert 740 < box["y"] + box["height"] < 768
        plot.click(position={"x": 0.5 * box["width"], "y": 300})
        page.locator(".trajectory").get_by_text("pairs of flights").wait_for()
        page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        box, drawer = plot.bounding_box(), page.locator(".trajectory").bounding_box()
        assert drawer["height"] > 230
        assert box["y"] + box["height"] < drawer["y"]


def test_axes_are_made_logarithmic_on_the_page_and_in_its_files(showing: Any):
    with showing(omega=0.6, xi=0.05) as page:
        axes = page.locator(".panel .plot [id^=axes]")
        assert "(rad) from 0 to" in axes.inner_text()
        page.get_by_role("button", name="log y").click()
        axes.filter(has_text=re.compile(r"\(rad\) from 0\.\d+ to")).wait_for(state="attached")
        page.locator(".panel .plot").hover(position={"x": 400, "y": 300})
        page.mouse.wheel(0, 400)  # all is shown already
        page.wait_for_url(re.compile("log=y"))
        assert "y0" not in page.url
        with page.expect_request(lambda request: "format=svg" in request.url) as request:
            page.get_by_role("button", name="Download SVG").click()
        assert "log=y" in request.value.url
        page.get_by_role("button", name="log y", pressed=True).click()
        page.wait_for_url(re.compile("log=none"))


def test_a_window_of_a_ramp_keeps_the_ends_where_it_begins(showing: Any):
    with showing(omega=0.6, xi=0.05, x0=0.5, x1=0.6, y0=0, y1=6) as page:
        page.get_by_role("button", name="Compute this window").click()
        page.locator(".cost", has_text="cells in").wait_for()
        fields = [page.locator(f"[data-field='gamma.{name}']") for name in ("start", "stop", "num")]
        assert [field.input_value() for field in fields] == ["0.3", "1.4", "1211"]
        page.get_by_text("The first cell begins from rest, or on a cycle; a window reaches back").wait_for()
        contact = page.get_by_label("contact model")  # as that of the ramp
        assert contact.is_hidden()
        page.get_by_role("button", name="All settings").click()
        contact.wait_for()


def _width(page: Any) -> float:
    low, high = (float(re.search(f"{name}=([^&]+)", page.url)[1]) for name in ("x0", "x1"))  # type: ignore[index]
    return high - low


def test_two_fingers_zoom(showing: Any):
    with showing(options={"has_touch": True}, omega=0.6, xi=0.05) as page:
        box = page.locator(".panel .plot").bounding_box()
        touch = page.context.new_cdp_session(page)
        for kind, apart in (("touchStart", 50), ("touchMove", 80), ("touchMove", 120), ("touchEnd", None)):
            at = [] if apart is None else [box["x"] + 400 - apart, box["x"] + 400 + apart]
            points = [{"x": x, "y": box["y"] + 200, "id": i} for i, x in enumerate(at)]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        page.wait_for_url(re.compile("x0=.*y1="))
        wait_for(lambda: _width(page) < 0.9)  # of 1.1; a busy browser drops some of the moves


def test_a_drag_with_shift_moves_the_window(showing: Any):
    window = {"x0": 0.6, "x1": 0.8, "y0": 1, "y1": 4}
    with showing(omega=0.6, xi=0.05, **window) as page:
        box = page.locator(".panel .plot").bounding_box()
        page.mouse.move(box["x"] + 500, box["y"] + 300)
        page.keyboard.down("Shift")
        page.mouse.down()
        page.mouse.move(box["x"] + 400, box["y"] + 300, steps=4)
        page.mouse.up()
        page.keyboard.up("Shift")
        page.wait_for_url(re.compile(r"x0=0\.6[1-9]"))
        wait_shown(page, omega=0.6)
        page.keyboard.down("Shift")
        page.mouse.down()
        page.mouse.move(box["x"] + 401, box["y"] + 300)
        page.mouse.move(box["x"] + 5000, box["y"] + 300)  # at once beyond the edge of the data
        page.mouse.up()
        page.keyboard.up("Shift")
        page.wait_for_url(re.compile("x0=0.295&x1=0.495&"))
        page.mouse.move(box["x"] + 400, box["y"] + 300)
        page.mouse.dblclick(box["x"] + 400, box["y"] + 300)  # shows everything, and no cell
        page.get_by_role("button", name="Show all").wait_for(state="hidden")
        page.wait_for_timeout(500)
        assert page.locator(".trajectory").is_hidden()


def test_exponents_are_drawn_below_the_diagram(browser: Any, address: str):
    job = done(address, spec_of((1.5, 4, 26), 0.5, 0.26, window=(20, 40), exponents=1))
    with opened(browser, view(address, job)) as page:
        below = page.get_by_role("img", name="Largest Lyapunov exponent")
        below.wait_for()
        wait_for(lambda: colours(page, ".plot + .plot canvas") > 2)
        assert "λ₁ per plate period" in below.inner_text()
        assert page.pdf(format="A4").count(b"/Type /Page\n") == 1  # an empty sheet came before both plots
        page.get_by_text("Table of what is shown").click()
        rows = table_of(page)
        stored = httpx2.get(f"{address}/v1/jobs/{job}/diagram", timeout=DEADLINE).json()["data_vars"]
        assert [float(row["λ₁"]) for row in rows] == [first for [first] in stored["lyapunov"]["data"]]
        assert [float(row["error of λ₁"]) for row in rows] == stored["lyapunov_error"]["data"]
        for shown in page.locator(".legend button").all():
            shown.click()
        wait_for(lambda: "λ₁ from −0.1 to 0.1" in below.inner_text())  # of no cell


def test_a_click_on_a_cell_plays_its_trajectory(showing: Any):
    with showing(omega=0.6, xi=0.05, show="down") as page:
        box = page.locator(".panel .plot").bounding_box()
        # Γ = 0.65, between the margins of the plot: on the ramp down it bounces there.
        at = box["x"] + 58 + (0.65 - 0.3) / 1.1 * (box["width"] - 92), box["y"] + 150
        page.mouse.move(*at)
        text = "Γ = 0.65 · Ω = 0.6 · ξ = 0.05 · ramp: down · mode (1, 1)"
        readout = page.locator(".panel .readout", has_text=text)
        readout.wait_for()
        page.mouse.click(*at)
        _phase_after(page, _phase_after(page, None))
        wait_for(lambda: colours(page, ".trajectory .animation") > 3)
        wait_for(lambda: colours(page, ".trajectory .plot canvas") > 4)
        page.locator(".trajectory .readout", has_text="complete flights in 4 plate periods").wait_for()
        page.wait_for_url(re.compile("cell=.*,down"))
        page.get_by_role("button", name="Pause").click()
        still = page.locator(".trajectory .player").get_attribute("data-phase")
        page.wait_for_timeout(120)
        assert page.locator(".trajectory .player").get_attribute("data-phase") == still
        page.route("**/trajectory?*", lambda route: None)  # without an answer
        page.locator(".panel .plot").press("ArrowRight")
        page.keyboard.press("Enter")
        page.locator(".trajectory .player").wait_for(state="hidden")  # it would seem to be of this cell
        page.get_by_role("button", name="Close").click()
        assert page.locator(".trajectory").is_hidden()


def _phase_after(page: Any, before: str | None) -> str:
    page.wait_for_function(
        """before => {
            const { phase } = document.querySelector(".player")?.dataset ?? {};
            return phase && phase !== before;
        }""",
        arg=before,
    )
    return str(page.locator(".player").get_attribute("data-phase"))


#: Keeps the height in pixels of the longest line from point to point in a phase portrait.
_KEEP_LONGEST = """{
    const drawing = CanvasRenderingContext2D.prototype;
    const { moveTo, lineTo } = drawing;
    let last;
    window.longest = 0;
    drawing.moveTo = function (x, y) { last = y; moveTo.call(this, x, y); };
    drawing.lineTo = function (x, y) {
        if (this.canvas.closest(".portraits > :last-child"))
            window.longest = Math.max(window.longest, Math.abs(y - last));
        last = y;
        lineTo.call(this, x, y);
    };
}"""


def test_a_phase_portrait_is_interrupted_where_the_spring_meets_the_plate(browser: Any, address: str):
    """Between two samples: the contacts of a restitution take no time."""
    job = done(address, spec_of([2.0, 2.5], 0.6, 0.1, model={"kind": "rigid", "restitution": 0.8}))
    path = f"/v1/jobs/{job}/trajectory?gamma=2.5&periods=4&samples=240"
    motion = httpx2.get(address + path, timeout=DEADLINE)
    velocity = motion.json()["data_vars"]["velocity"]["data"]
    with opened(browser, "about:blank", reduced_motion="reduce") as page:
        page.add_init_script(_KEEP_LONGEST)
        page.goto(view(address, job, cell="2.5,0.6,0.1,rest"))
        page.locator(".trajectory .readout", has_text="complete flights").wait_for()
        wait_for(lambda: page.evaluate("longest") > 0)
        height = page.locator(".portraits canvas").last.bounding_box()["height"]
        longest = page.evaluate("longest")
    assert max(abs(np.diff(velocity))) > 0.5 * np.ptp(velocity)
    assert longest < 0.1 * height


def test_a_variable_added_to_the_schema_is_in_the_details_of_a_cell(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    added = add_stored_variable(monkeypatch)
    monkeypatch.setattr(embedded, "Processes", lambda processes: InThisProcess())
    with computing_at(tmp_path) as address:
        job = done(address, {**LOOP, "protocol": {"kind": "rest"}})
        with opened(browser, view(address, job, cell="1.4,0.6,0.05,rest")) as page:
            page.get_by_text("All values of the cell").click()
            row = page.locator(".trajectory tr", has_text=added.attrs["long_name"])
            assert int(row.locator("td").inner_text()) > 1
            assert page.locator(".trajectory tr", has_text="what became of the cell").count() == 1


def test_tabs_share_the_damping_and_the_selected_cell(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop), reduced_motion="reduce") as page:
        wait_shown(page, along="gamma", xi=0.1)
        for tab in ("Mode map", "Thresholds"):
            page.get_by_role("link", name=tab).click()
            wait_shown(page, xi=0.1)
        open_tab(page, "Mode map")
        wait_shown(page, direction="up")
        page.locator(".panel .plot").focus()
        for key in ("ArrowRight", "ArrowUp", "ArrowUp", "Enter"):
            page.keyboard.press(key)
        page.wait_for_url(re.compile("cell=0.86,0.8,0.1,up"))
        open_tab(page, "Diagram")
        wait_shown(page, along="gamma", omega=0.8, xi=0.1)
        page.get_by_label("Axis of the diagram").select_option("omega")
        wait_shown(page, along="omega", xi=0.1)
        page.locator("[aria-valuetext='Γ = 0.86']").wait_for()


#: Holds the request for what the service runs on until release() is called.
_HOLD = """const { promise, resolve } = Promise.withResolvers(), send = window.fetch;
window.release = resolve;
window.fetch = async (path, options) => {
    if (path === "/v1/software") await promise;
    return send(path, options);
}"""


def test_details_that_were_left_do_not_come_back(browser: Any, address: str, loop: str):
    with opened(browser, "about:blank") as page:
        page.add_init_script(_HOLD)
        page.goto(view(address, loop, "details"))
        page.get_by_role("heading", name="Origin").wait_for()
        open_tab(page, "Diagram")
        wait_shown(page, along="gamma")
        page.evaluate("async () => { release(); await (await fetch('/v1/software')).json(); }")
        page.wait_for_timeout(100)
        assert page.locator(".panel .plot").is_visible()


def test_the_picture_of_the_readme(browser: Any, address: str):
    """Kept in test-artefacts/page/figure-2.png."""
    job = done(address, spec_of((1.0, 6.0, 1001), 0.5, 0.26, name="Figure 2"))
    with opened(browser, view(address, job, cell="2.3,0.5,0.26,rest"), reduced_motion="reduce") as page:
        page.get_by_label("Plate periods since").fill("1.2")
        page.locator(".trajectory .readout", has_text="3.722, 6.285").wait_for()
        page.evaluate("document.activeElement.blur()")  # no focus ring in the picture
        screenshot(page, "figure-2", whole=False)


#: What is announced from now on.
_HEAR = """() => {
    const status = document.getElementById("status");
    window.heard = [];
    new MutationObserver(() => heard.push(status.textContent)).observe(status, { childList: true });
}"""


def test_a_ramp_along_the_frequency_opens_on_its_diagram(browser: Any, address: str):
    ramp = {"protocol": {"kind": "ramp", "axis": "omega", "direction": "up"}}
    job = done(address, spec_of([1.2, 2.0], (0.4, 0.9, 12), 0.1, window=(40, 12, 8)) | ramp)
    with opened(browser, view(address, job, "")) as page:
        wait_shown(page, along="omega")


#: Numbers as a table's CSV has them.
_PLAIN = """async (numbers) => {
    const { number, plain } = await import(new URL("static/js/lib/format.js", location).href);
    return numbers.map((value) => plain(number(value)));
}"""


def test_home_goes_to_the_first_cell_at_once_and_minus_undoes_plus(showing: Any):
    with showing(xi=0.05, omega=0.6) as page:
        plot = page.locator(".panel .plot").first
        plot.press("Home")
        assert page.locator(".panel .readout").first.inner_text().startswith("Γ = 0.3 ")
        everything = page.get_by_role("button", name="Show all")
        for key, state in (("+", "visible"), ("-", "hidden")):
            plot.press(key)
            everything.wait_for(state=state)


def test_what_a_plot_shows_is_text_and_a_table(showing: Any):
    """Axes are text and described; the table has what is in the window and not hidden, 25 rows at a time."""
    with showing(xi=0.05, omega=0.6) as page:
        plot = page.locator(".panel .plot").first
        texts = plot.locator(".texts span").all_inner_texts()
        assert {"plate acceleration over gravity Γ", "flight time φ (rad)", "0.3", "1.4", "ramp up"} <= set(
            texts
        )
        described = page.locator(f"#{plot.get_attribute('aria-describedby')}").inner_text()
        assert "plate acceleration over gravity Γ from 0.295 to 1.405. flight time φ (rad) from" in described
        page.get_by_role("complementary", name="Bifurcation diagram").wait_for()  # a stop of Firefox
        page.get_by_text("Table of what is shown").click()
        rows, status = page.locator(".paged tbody tr"), page.locator(".paged [role=status]").first
        wait_for(lambda: rows.count() == 25)
        assert status.inner_text() == "1 to 25 of 222"
        page.get_by_role("button", name="Next rows").click()
        assert rows.first.inner_text().split("\t")[:3] == ["0.55", "up", "at rest on the plate"]
        page.get_by_role("button", name="at rest").click()
        page.wait_for_url(re.compile("hide="))
        page.goto(f"{page.url}&x0=0.75&x1=1.1&y0=0&y1=5")
        page.get_by_text("Table of what is shown").click()
        status.filter(has_text=re.compile("^1 to 25 of [67][0-9]$")).wait_for()
        page.locator(".panel .plot").first.focus()
        for key, gamma in (("ArrowRight", 0.935), ("End", 1.1), ("Home", 0.75)):  # within the window
            page.keyboard.press(key)
            said = page.locator(".panel .readout").inner_text()
            assert float(said.split()[2]) == pytest.approx(gamma, abs=0.02)
        assert "at rest" not in page.locator(".paged table").inner_text()
        table = download(page.get_by_role("button", name="Download table as CSV")).read_text()
        assert table.startswith("Γ,Ω,ξ,ramp,mode,flight times (rad)\n0.")
        assert not set("…–−^") & set(table)  # plain numbers, and all of them
        assert page.evaluate(_PLAIN, [2.38e-7, -1e-9, 0.5, math.nan]) == ["2.38e-7", "-1e-9", "0.5", ""]


_LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def test_neighbours_on_a_fine_axis_have_different_texts_and_bounds_are_rounded_up(browser: Any, address: str):
    job = done(address, spec_of((1.23456, 1.23457, 11), 0.5, 0.2))
    stored = httpx2.get(f"{address}/v1/jobs/{job}/diagram", timeout=DEADLINE).json()
    gamma, bounds = stored["coords"]["gamma"]["data"], stored["data_vars"]["flight_error"]["data"]
    with opened(browser, view(address, job, cell=f"{gamma[3]},0.5,0.2,rest")) as page:
        page.get_by_text("Γ 1.23456 – 1.23457 (11)").wait_for()
        page.get_by_text("Γ = 1.234563, Ω = 0.5, ξ = 0.2, from rest").wait_for()
        page.keyboard.press("Escape")
        box = page.locator(".panel .plot").bounding_box()
        page.mouse.move(box["x"] + 400, box["y"] + 100)
        page.mouse.down()
        page.mouse.move(box["x"] + 405, box["y"] + 500, steps=5)
        page.mouse.move(box["x"] + 480, box["y"] + 500, steps=5)
        page.mouse.up()
        page.wait_for_url(re.compile("x0="))
        assert 5e-7 < _width(page) < 2e-6
        page.get_by_role("button", name="Show all").click()
        page.get_by_text("Table of what is shown").click()
        names = page.locator(".paged tbody th")
        wait_for(lambda: names.count() == len(gamma))
        assert names.all_inner_texts()[:3] == ["1.23456", "1.234561", "1.234562"]
        errors = page.locator(".paged tbody td:nth-child(4)").all_inner_texts()
        rows = table_of(page)
        assert [float(row["Γ"]) for row in rows] == gamma
        powers = [text if "·" in text else f"1·{text}" for text in errors]
        shown = [float(text.replace("·10", "e").translate(_LOWERED)) for text in powers]
        assert all(bound <= text <= 2 * bound for bound, text in zip(bounds, shown, strict=True))
        assert [float(row["flight error ≤ (rad)"]) for row in rows] == bounds
        page.get_by_role("link", name="Duplicate").click()
        page.get_by_text("11 values: 1.23456, 1.234561, 1.234562 … 1.23457").wait_for()


def test_the_keyboard_reaches_every_cell(showing: Any):
    with showing("modes", options={"reduced_motion": "reduce"}, xi=0.05) as page:
        page.locator(".panel .plot").focus()
        page.evaluate(_HEAR)
        for key in ("ArrowRight", "Shift+ArrowRight", "ArrowUp"):
            page.keyboard.press(key)
        wait_for(lambda: page.evaluate("heard.length") > 0)
        assert page.evaluate("heard") == [page.locator(".panel .readout").inner_text()]  # the last one alone
        assert page.evaluate("heard[0]").startswith("Γ = 0.96 · Ω = 0.75 · ")
        assert page.locator("#status").get_attribute("role") == "status"
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Play").wait_for()
        page.keyboard.press("+")
        page.wait_for_url(re.compile("x0="))
        page.locator("#status", has_text="over gravity Γ from").wait_for(state="attached")
        page.go_back()
        page.wait_for_url(re.compile("^((?!x0=).)*$"))
        page.locator(".panel .plot:focus").wait_for()
        page.locator(".tabs a", has_text="Thresholds").focus()
        page.keyboard.press("Enter")
        page.locator(".tabs [aria-current]:focus", has_text="Thresholds").wait_for()


def test_the_mode_map_is_hatched_where_up_and_down_differ(showing: Any, address: str, loop: str):
    path, query = f"{address}/v1/jobs/{loop}/modes", {"xi": 0.05, "hysteresis": True}
    plane = httpx2.get(path, params=query, timeout=DEADLINE).json()["data_vars"]
    rows = plane["hysteresis"]["data"]
    cells = [value for row in rows for value in row]
    assert 0 < cells.count(1) < len(cells)
    with showing("modes", xi=0.05) as page:
        page.get_by_text(
            f"lead to other modes (hatched /) in {100 * cells.count(1) / len(cells):.2g} %"
        ).wait_for()
        hatched = picture(page)
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        said = set()
        for _ in range(len(rows[0]) // 2):
            said.add("ramped down: another mode" in page.locator(".panel .readout").inner_text())
            page.keyboard.press("ArrowLeft")
        assert said == {True, False}
        page.keyboard.press("Escape")
        page.get_by_label("Hatch where up and down differ").uncheck()
        wait_for(lambda: picture(page) != hatched)
        page.wait_for_url(re.compile("hatch=0"))
        page.reload()
        wait_shown(page, xi=0.05)
        assert not page.get_by_label("Hatch where up and down differ").is_checked()
        assert page.get_by_text("Hysteresis: going up").count() == 0


_COUNT_READINGS = """() => {
    window.readings = 0;
    window.URLSearchParams = class extends URLSearchParams {
        constructor(...given) { super(...given); window.readings += 1; }
    };
}"""


def test_the_legend_of_a_map_hides_modes_and_has_shares_of_the_cells_shown(
    browser: Any, address: str, loop: str
):
    with opened(browser, view(address, loop, "modes", xi=0.05)) as page:
        page.get_by_text("Hysteresis: going up").wait_for()
        shown, at_rest = picture(page), page.locator(".legend").get_by_role("button", name="at rest")
        at_rest.press("Enter")
        wait_for(lambda: picture(page) != shown)
        page.locator(":focus[aria-pressed=false]", has_text="at rest").wait_for()
        page.wait_for_url(re.compile("hide="))
        page.evaluate(_COUNT_READINGS)
        page.get_by_text("Table of what is shown").click()
        page.locator(".paged tbody tr").first.wait_for()
        assert page.evaluate("window.readings") < 10  # of the address, not one per cell
        at_rest.click()
        wait_for(lambda: picture(page) == shown)
        page.evaluate("location.hash += '&x0=0.3&x1=0.4&y0=0.5&y1=0.7'")
        page.get_by_text("Up and down agree in every cell shown").wait_for()
        assert page.locator(".panel .legend li").all_inner_texts() == ["at rest 100 %"]
        assert "Eq. 25" not in page.locator(".panel .plot .texts").text_content()  # not in view


def test_a_wide_screen_shows_the_diagram_under_the_pointer_beside_the_map(showing: Any):
    with showing("modes", options={"viewport": {"width": 1920, "height": 1080}}, xi=0.05) as page:
        plot = page.locator(".panel .plot")
        box = plot.bounding_box()
        page.wait_for_timeout(300)  # the window's size is settled
        plot.evaluate("plot => plot.addEventListener('drawn', () => { plot.dataset.redrawn = true; })")
        shown = set()
        for part in (0.2, 0.8):
            plot.hover(position={"x": box["width"] / 2, "y": part * box["height"]})
            page.wait_for_function(
                "seen => !seen.includes(document.querySelector('.beside .plot').dataset.shown)",
                arg=[*shown, None],
            )
            shown.add(page.locator(".beside .plot").get_attribute("data-shown"))
        page.wait_for_timeout(300)
        assert plot.get_attribute("data-redrawn") is None  # only its cursor has moved
        page.locator(".panel").first.get_by_role("button", name="log y").click()
        page.wait_for_url(re.compile("log=y"))  # of the frequency, which the diagram has not
        page.wait_for_timeout(300)
        assert "φ (rad) from 0 to" in page.locator(".beside .plot").first.inner_text()


def test_a_map_shows_the_margin_of_stability_of_certified_cells(browser: Any, address: str):
    margins = spec_of((1.0, 2.4, 57), (0.45, 0.6, 16), 0.26, name="Margins")
    job, filled = done(address, margins), done(address, margins | {"refine": {"by": "mode"}})
    with opened(browser, view(address, filled, "modes")) as page:
        page.locator(".note", has_text="Adaptive map").wait_for()
        page.get_by_label("Colour").select_option("margin of stability |μ|")
        page.locator(".legend", has_text="|μ| 0.2 to 0.4").wait_for()
        assert "(1, 1)" not in page.locator(".legend").inner_text()  # filled cells have a margin, too
    with opened(browser, view(address, job, "modes")) as page:
        page.locator(".legend", has_text="(1, 1)").wait_for()
        page.get_by_label("Colour").select_option("margin of stability |μ|")
        page.locator(".legend", has_text="|μ| 0.2 to 0.4").wait_for()
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        page.locator(".panel .readout", has_text="|μ|: 0.").wait_for()
        assert "flight error ≤" in page.locator(".panel .readout").inner_text()
        page.get_by_text("Table of what is shown").click()
        rows = table_of(page)
    answer = httpx2.get(f"{address}/v1/jobs/{job}/modes?color=multiplier", timeout=DEADLINE).json()
    stored = chain(*answer["data_vars"]["multiplier"]["data"])
    assert [float(row["|μ|"] or "nan") for row in rows] == pytest.approx(
        [math.nan if modulus is None else modulus for modulus in stored], rel=0, abs=0, nan_ok=True
    )


def test_what_is_copied_and_saved_says_of_which_spring_and_as_sharply_as_known(browser: Any, address: str):
    job = done(address, spec_of((1.6, 1.8, 5), [0.7, 0.9], 0.26))
    stored = httpx2.get(f"{address}/v1/jobs/{job}/diagram?omega=0.9", timeout=DEADLINE).json()
    flight = stored["data_vars"]["flight_time"]["data"][2][0]
    with opened(browser, view(address, job, omega=0.9)) as page:
        wait_shown(page, omega=0.9)
        page.locator(".panel .plot").press("ArrowRight")
        said = page.locator(".panel .readout", has_text="Γ = 1.7 · Ω = 0.9 · ξ = 0.26 · mode (1, 1) · ")
        assert f"flight times (rad): {flight:.8g}" in said.inner_text()
        page.get_by_text("Table of what is shown").click()
        rows = table_of(page)
        assert {(row["Ω"], row["ξ"]) for row in rows} == {("0.9", "0.26")}
        assert float(rows[2]["flight times (rad)"]) == flight


def test_a_map_of_too_many_cells_is_thinned_until_it_is_zoomed(browser: Any, tmp_path: Path):
    with computing_at(tmp_path, max_points=1000) as address:
        job = done(address, spec_of((0.5, 6.0, 60), (0.4, 1.6, 40), 0.05, window=(2, 8, 8)))
        with opened(browser, view(address, job, "modes"), expected=("413",)) as page:
            note = page.get_by_text("Shown: 1 in 2")
            note.wait_for()
            asked: list[int] = []
            page.on("response", lambda response: "/modes" in response.url and asked.append(response.status))
            for tab in ("Diagram", "Mode map"):
                open_tab(page, tab)
            note.wait_for()
            assert asked == [200]  # what was refused once is not asked for again
            page.locator(".panel .plot").focus()
            for _ in range(3):
                page.keyboard.press("+")
            note.wait_for(state="hidden")


def test_thresholds_are_those_of_the_service(showing: Any, address: str, loop: str):
    with showing("thresholds", xi=0.05) as page:
        assert colours(page) > 4
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        answer = httpx2.get(f"{address}/v1/jobs/{loop}/threshold?xi=0.05", timeout=DEADLINE).json()
        expected = {name: about["data"] for name, about in (answer["coords"] | answer["data_vars"]).items()}
        wait_for(lambda: page.locator("#status").inner_text())
        text = page.locator("#status").inner_text()
        assert text.startswith(
            f"Ω = {expected['omega'][4]:g} · ξ = 0.05 · Eq. 25: {expected['analytic'][4]:.4g}"
        )
        assert expected["up_status"][4] == "found"
        assert f"ramp up: {expected['up'][4]:.4g}" in text


def test_a_sweep_says_how_many_cells_were_settling(browser: Any, address: str):
    job = done(address, spec_of((0.6, 1.5, 46), 1.0, 0.01, window=(20, 60, 4), name="Short"))
    with opened(browser, view(address, job, "modes")) as page:
        page.locator(".notice", has_text="still settling after 80 plate periods").wait_for()
        page.locator(".legend", has_text="still settling").wait_for()
        shown = page.get_by_role("link", name="give more time").element_handle()
        with Client(address) as client:
            client.job(job).rename("Shorter")
        page.locator("#bar h1", has_text="Shorter").wait_for()
        shown.click()  # it is not drawn anew while the sweep changes
        page.locator("[data-field='settle']:focus").wait_for()


def test_on_paper_nothing_is_cut_off_or_covered(browser: Any, address: str, loop: str):
    height = "element => [element.scrollHeight, element.clientHeight]"
    with opened(browser, view(address, loop)) as page:
        wait_shown(page, along="gamma")
        page.emulate_media(media="print")
        plot, canvas = page.locator(".panel .plot"), page.locator(".panel .plot canvas").first
        canvas.evaluate("canvas => { canvas.style.height = '2000px'; }")  # of a drawing for the screen
        assert canvas.bounding_box() == plot.bounding_box()
        unprinted = (".downloads", ".cursor", ".tabs", "select", ".slider", ".actions")
        assert all(page.locator(name).first.is_hidden() for name in unprinted)
        page.emulate_media(media="screen")
        open_tab(page, "Details")
        page.emulate_media(media="print")
        shown, clipped = page.locator("pre").first.evaluate(height)
        assert shown == clipped


def test_a_study_of_cycles_opens_on_its_branches_and_one_of_them_moves(browser: Any, address: str):
    orbits = {"name": "Folds", "protocol": {"kind": "orbits"}, "omega": [0.6, 0.7], "xi": 0.05}
    job = done(address, orbits | {"modes": ["1-1", "1-2"], "points": 100})
    answer = httpx2.get(f"{address}/v1/jobs/{job}/orbits?omega=0.7", timeout=DEADLINE).json()["data_vars"]
    admissible = answer["event_violations"]["data"].count(0)
    with opened(browser, address) as page:
        page.locator("text=· cycles").first.wait_for()
        page.get_by_role("link", name="Folds").click()
        wait_shown(page, omega=0.7)
        assert page.locator(".tabs a").all_inner_texts() == ["Branches", "Details"]
        assert page.locator(".paged tbody tr").count() == admissible
        plot = page.locator(".panel .plot")
        plot.focus()
        plot.press("ArrowUp")
        readout = page.locator(".panel .readout").inner_text()
        assert re.match(r"Γ = [\d.]+ · cycle \(1, [12]\), (un)?stable · flight time", readout)
        plot.press("Enter")
        page.locator(".trajectory .readout", has_text="On the cycle (1, ").wait_for()
        page.get_by_text("Table of what is shown").click()
        page.locator(".paged td", has_text=re.compile("^(un)?stable$")).first.wait_for()
        page.get_by_label("Value of Ω").fill("0.6")
        page.get_by_label("Value of Ω").press("Enter")
        wait_shown(page, omega=0.6)
        table = download(page.locator(".panel").get_by_role("button", name="Download CSV", exact=True))
        assert "flight_time" in table.read_text().splitlines()[0]
    with opened(browser, view(address, job, "diagram")) as page:  # an address made for a sweep
        wait_shown(page, xi=0.05)


# Speed


def test_the_page_lists_sweeps_and_plays_a_trajectory(browser: Any, address: str, loop: str):
    with opened(browser, address) as page:
        page.locator(".jobs li").first.wait_for()
        assert page.evaluate("performance.now()") < SLOW_MS
        assert page.locator(".intro").is_hidden()
        page.get_by_role("link", name="Explore").first.click()
        _phase_after(page, _phase_after(page, None))
        page.locator(".readout", has_text="3.722, 6.285").wait_for()  # docs/model.md, section 5


def test_a_million_flights_do_not_block_the_page(browser: Any, address: str):
    job = done(address, LONG_LINE)
    with opened(browser, "about:blank") as page:
        watch_tasks(page)
        page.goto(view(address, job))
        wait_shown(page, along="gamma")
        assert colours(page) > 10
        with download(page.get_by_role("button", name="Download CSV", exact=True)).open() as table:
            assert next(table).replace('"', "").startswith("flight,direction,omega,xi,gamma,flight_time,")
        page.locator(".panel .plot").focus()
        page.keyboard.press("ArrowRight")
        whole = picture(page)
        page.keyboard.press("+")
        page.wait_for_url(re.compile("x0="))
        page.wait_for_function(
            "before => document.querySelector('.panel .plot canvas').toDataURL() !== before", arg=whole
        )
        assert longest_task(page) < SLOW_MS


#: Where, in px, 5000 flights of 4.97 rad are drawn; and where the texts below a plot end.
_DRAWN = """Promise.all(["flights", "frame", "colours"].map(
    (name) => import(new URL(`static/js/plot/${name}.js`, location)))
).then(([{ drawFlights }, frame, { theme }]) => {
    const ctx = new OffscreenCanvas(300, 200).getContext("2d");
    const y = { low: 0, high: 10, log: false, pixel: (value) => 200 - 20 * value };
    const x = { low: 0, high: 300, pixel: (value) => value };
    const box = { left: 0, top: 0, width: 300, height: 200, ratio: 1, x, y };
    const values = Float64Array.from({ length: 100 }, (_, i) => 3 * i);
    const flights = new Float64Array(5000).fill(4.97);
    drawFlights(ctx, box, [{ values, keep: 50, flight_time: flights }], () => "#000000");
    const { data } = ctx.getImageData(0, 0, 300, 200);
    const rows = [...Array(200).keys()].filter((row) => data[1200 * row + 603]); // at x = 150
    const content = { x: { label: "", low: 2.3, high: 2.3000000005 }, y: { label: "", low: 0, high: 1 } };
    const plot = frame.boxOf(ctx, content, 300, 200, theme(), 1);
    frame.drawFrame(ctx, plot, content);
    ctx.font = `13px ${theme().serif}`;
    const ends = plot.texts.filter(({ align }) => align === "center").flatMap(({ text, x }) => {
        const half = ctx.measureText(text).width / 2;
        return [x - half, x + half];
    });
    return [(rows[0] + rows.at(-1) + 1) / 2, Math.min(...ends), Math.max(...ends)];
})"""


def test_flights_and_texts_are_drawn_where_they_belong(browser: Any, address: str):
    with opened(browser, address) as page:
        row, left, right = page.evaluate(_DRAWN)
    assert row == pytest.approx(200 - 20 * 4.97, abs=0.5)
    assert -0.5 <= left < right <= 300.5


# Accessibility and small screens


CELL = "xi=0.05&omega=0.6&cell=0.65,0.6,0.05,down"
TABS = ("diagram", "modes", "thresholds", "details")
VIEWS = (
    "", "#/new?figure=9", *(f"#/job/JOB/{tab}?{CELL}" for tab in TABS),
    "#/compare?jobs=JOB,OTHER", "#/explore", "docs",
)  # fmt: skip
SIZES = ((1280, 800), (820, 1180), (375, 740))


@pytest.fixture(scope="module")
def other(address: str) -> str:
    """Another sweep, to compare with."""
    return done(address, {**LOOP, "name": "Other", "xi": 0.2, "settle": 20})


#: Light at all sizes; dark, where other colours alone may differ, at one.
LOOKS = (*(("light", size) for size in SIZES), ("dark", SIZES[-1]))


def test_axe_finds_nothing_serious(browser: Any, address: str, loop: str, other: str):
    """With BOUNCE_TEST_SCREENSHOTS set, each view in each look is kept as a picture."""
    axe = (ROOT / "tests" / "vendor" / "axe.min.js").read_text()
    with opened(browser, "about:blank", reduced_motion="reduce") as page:
        page.add_init_script(axe)
        for path in VIEWS:
            reopen(page, f"{address}/{path.replace('JOB', loop).replace('OTHER', other)}")
            _wait_complete(page, path)
            for scheme, (width, height) in LOOKS:
                page.emulate_media(color_scheme=scheme)
                page.set_viewport_size({"width": width, "height": height})
                if "BOUNCE_TEST_SCREENSHOTS" in os.environ:
                    screenshot(page, f"{scheme}-{width}-{VIEWS.index(path)}")
                assert _serious(page) == [], (path, scheme, width)


def test_a_pressed_button_is_told_from_others_in_forced_colours(browser: Any, address: str, loop: str):
    with opened(browser, view(address, loop, log="x"), forced_colors="active") as page:
        wait_shown(page, along="gamma")
        buttons = [page.get_by_role("button", name=f"log {axis}") for axis in "xy"]
        pressed, other = (
            button.evaluate("button => getComputedStyle(button).backgroundColor") for button in buttons
        )
        assert pressed != other


def _serious(page: Any) -> list[tuple[str, str]]:
    """The serious violations of the document."""
    violations = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")["violations"]
    return [
        (rule["id"], rule["nodes"][0]["html"])
        for rule in violations
        if rule["impact"] in ("serious", "critical")
    ]


def test_every_view_fits_a_phone(browser: Any, address: str, loop: str, other: str):
    """And says tap, not click."""
    phone = {"viewport": {"width": 375, "height": 740}, "has_touch": True, "is_mobile": True}
    with opened(browser, address, reduced_motion="reduce", **phone) as page:
        for path in VIEWS:
            reopen(page, f"{address}/{path.replace('JOB', loop).replace('OTHER', other)}")
            _wait_complete(page, path)
            assert page.evaluate("document.documentElement.scrollWidth") <= 375, path
            assert not re.search(r"\b(double-)?click", page.locator("body").inner_text(), re.IGNORECASE), path


def test_maps_fit_every_desktop(browser: Any, address: str):
    """A cancelled one with many cells and buttons, and one with many classes in its legend."""
    cancelled = submitted(address, spec_of((0.9, 6.0, 301), (0.3, 1.2, 301), 0.05, name="Cancelled"))
    httpx2.post(f"{address}/v1/jobs/{cancelled}/cancel", timeout=DEADLINE).raise_for_status()
    fields = {"refine": {"by": "mode"}, "exponents": 1, "name": "Many classes"}
    classes = done(address, spec_of((0.8, 3.0, 33), (0.4, 1.2, 33), 0.05, window=(50, 50, 8), **fields))
    with opened(browser, address) as page:
        for width in (1024, 1280):
            page.set_viewport_size({"width": width, "height": 800})
            for job in (cancelled, classes):
                reopen(page, view(address, job, "modes"))
                page.locator("#bar").get_by_role("button", name="Delete").wait_for()
                page.locator(f".panel .legend li >> nth={0 if job == cancelled else 12}").wait_for()
                assert page.evaluate("document.documentElement.scrollWidth") <= width, job
        with Image.open(download(page.get_by_role("button", name="Download PNG"))) as image:
            # the legend above it makes no map lower
            assert image.height > 3 * (page.locator(".panel .plot").bounding_box()["height"] + 40)


def _wait_complete(page: Any, path: str) -> None:
    """Wait until the view has loaded everything."""
    if "/new" in path:
        page.locator(".cost", has_text="cells in").wait_for()
        return
    if path == "docs":
        return
    if "/compare" in path:
        page.locator(".panel .plot[data-shown]").wait_for()
        return
    if not path:
        page.locator(".jobs li").first.wait_for()
        return
    page.locator(".player[data-phase]").wait_for()
    if "/explore" in path:
        page.get_by_text(re.compile("of flights[.]$")).wait_for()
    elif "/details" not in path:
        page.locator(".panel .plot[data-shown]").wait_for()


# A service that is unreachable, and one that requires a token


def test_the_page_reconnects_to_a_service_that_was_restarted(browser: Any, tmp_path: Path):
    port = free_port()
    with ExitStack() as running:
        address = running.enter_context(computing_at(tmp_path, port=port))
        with opened(browser, f"{address}/#/new?figure=2", expected=("net::ERR_", "502")) as page:
            page.locator(".cost", has_text="cells in").wait_for()
            banner = page.locator("#offline")
            page.route("**/*", lambda route: route.fulfill(status=502, body="<html>"))  # of a proxy
            page.get_by_label("Name").fill("proxied")
            banner.wait_for()
            page.unroute_all()
            banner.wait_for(state="hidden")
            page.locator(".cost", has_text="cells in").wait_for()
            running.close()
            page.get_by_label("Name").fill("kept")
            banner.wait_for()
            banner.filter(has_text="does not answer").wait_for()
            running.enter_context(computing_at(tmp_path, port=port))
            banner.wait_for(state="hidden")
            page.locator(".cost", has_text="cells in").wait_for()
            assert page.get_by_label("Name").input_value() == "kept"


def test_the_page_takes_the_token_of_the_opened_address(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """As `bounce open` hands it over: through a file that only this user can read."""
    monkeypatch.setenv("BOUNCE_DATA", str(tmp_path))
    with computing_at(tmp_path, token="auto") as address:
        opened_by: list[str] = []
        monkeypatch.setattr(webbrowser, "open", lambda url: opened_by.append(url) or True)
        result = CliRunner().invoke(main, ["open", "--url", address])
        assert (result.exit_code, result.output) == (0, "")
        assert (tmp_path / "open.html").stat().st_mode & 0o077 == 0
        token = json.loads((tmp_path / "token.json").read_text())["token"]
        assert token not in opened_by[0]
        with opened(browser, opened_by[0]) as page:
            page.get_by_text("No sweeps yet").wait_for()
            assert page.url == f"{address}/#/"
            page.get_by_role("navigation").get_by_role("link", name="New", exact=True).click()
            page.locator(".cost", has_text="cells in").wait_for()
            page.reload()  # the tab keeps it
            page.locator(".cost", has_text="cells in").wait_for()
            assert token not in page.content()
            assert page.evaluate("Object.values(localStorage)") == []
        with opened(browser, address, expected=("401",)) as page:  # another tab does not
            dialog = page.get_by_role("dialog", name="Access token")
            dialog.get_by_label("Access token").fill("a-token-of-the-tests-mistyped")
            dialog.get_by_role("button").click()
            dialog.get_by_text("does not accept this access token").wait_for()
            page.goto(f"{address}/#token={token}")  # an address that is pasted
            dialog.wait_for(state="hidden")
            page.get_by_text("No sweeps yet").wait_for()
