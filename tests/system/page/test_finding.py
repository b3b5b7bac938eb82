"""The list of sweeps, found, pinned and deleted; comparison; one spring explored; what is taken away."""

import ast
import io
import json
import re
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from browser import download, needs_chromium, opened, reopen, wait_shown
from click.testing import CliRunner
from disks import read_only
from PIL import Image
from scripted import Held, wait_for
from served import computing_at, done, service_at
from studies import spec_of

from kernel.cycles.events import branch_and_events
from kernel.params import KERNEL_VERSION, Outcome
from kernel.threshold import threshold
from service.cli.main import main
from service.client import Client
from service.ledger.ledger import Ledger
from service.ledger.model import JobRecord, JobState, NewJob
from service.ledger.transactions import WriteTransaction
from worker.studies import from_json

pytestmark = needs_chromium

SMALL = spec_of((0.5, 3.0, 26), [0.5, 0.6], 0.05, window=(40, 12, 8))


@pytest.fixture(scope="module")
def jobs(address: str) -> list[str]:
    """Three sweeps of other dampings, done."""
    with Client(address) as client:
        submitted = [client.submit({**SMALL, "name": f"sweep {xi}", "xi": xi}) for xi in (0.05, 0.1, 0.2)]
        return [job.wait(progress=False).id for job in submitted]


def _names(page: Any) -> list[str]:
    return [str(name) for name in page.locator(".jobs li h2").all_text_contents()]


def _wait_names(page: Any, *names: str) -> None:
    page.wait_for_function(
        """names => names.join() ===
            [...document.querySelectorAll(".jobs li h2")].map((h2) => h2.textContent).join()""",
        arg=names,
    )


def test_an_address_of_nothing_leaves_a_page_that_works(browser: Any, address: str, jobs: list[str]):
    """Names that every object of the language has, and a token that is cut off."""
    with opened(browser, f"{address}/#/constructor", expected=("422",)) as page:
        for name in ("constructor", "toString", "__proto__"):
            page.goto(f"{address}/#/{name}")
            page.get_by_role("heading", name="Page not found").wait_for()
            assert page.title() == "Page not found · Bouncing spring"  # not of the sweep before
            page.goto(f"{address}/#/job/{jobs[0]}/{name}?cell=1,0.5,0.05,{name}")
            page.locator(".tabs a[aria-current=page]", has_text="Diagram").wait_for()
            page.locator(".trajectory .problem", has_text="direction").wait_for()
        page.goto(f"{address}/#token=%E0%A4%A")
        page.get_by_role("heading", name="Sweeps").wait_for()


def test_the_list_tells_why_no_sweep_is_accepted(browser: Any, tmp_path: Path):
    stores = tmp_path / "stores"
    with (
        computing_at(tmp_path / "data", stores=str(stores)) as address,
        opened(browser, address, hurried=True) as page,
    ):
        notice = page.locator(".notice", has_text="stores cannot be written: Read-only file system")
        with read_only(stores):
            notice.wait_for()
        notice.wait_for(state="hidden")


@pytest.fixture
def many(tmp_path: Path) -> Iterator[str]:
    """A service with thirty cancelled sweeps, half of each contact."""
    with _service_with(30, tmp_path) as address:
        yield address


@contextmanager
def _service_with(sweeps: int, folder: Path, pinned: bool = False) -> Iterator[str]:
    with Ledger(folder / "ledger.sqlite") as ledger, ledger.writing() as writing:
        for number in range(sweeps):
            kind = "soft" if number % 2 else "rigid"
            raw = {**SMALL, "name": f"number {number:02}", "xi": 0.1 + number / 100, "model": {"kind": kind}}
            spec = from_json(json.dumps(raw))
            text = json.dumps(spec.as_submitted())
            job = NewJob(spec.job_id(KERNEL_VERSION), spec.name, text, KERNEL_VERSION, (1, 2, 26), 1, 52)
            writing.insert(job, time.time())
            writing.finish(_found(writing, job.id), JobState.CANCELLED, time.time())
            writing.update(_found(writing, job.id), pinned=pinned)
    with service_at(folder, Held()) as address:
        yield address


def _found(writing: WriteTransaction, job_id: str) -> JobRecord:
    record = writing.find(job_id)
    assert record is not None
    return record


def test_of_many_pinned_sweeps_all_are_in_the_pages(browser: Any, tmp_path: Path):
    with _service_with(101, tmp_path, pinned=True) as address, opened(browser, address) as page:
        page.get_by_text("1 to 25 of 101, with 101 pinned").wait_for()
        for first in (26, 51, 76, 101):
            page.get_by_role("button", name="Next page").click()
            page.get_by_text(f"{first} to ").wait_for()
        _wait_names(page, "number 00")
        page.get_by_label("Find", exact=True).fill("number 1")  # few, as a refresh finds while it is typed
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        page.get_by_text("11 sweeps found").wait_for()


IN_SIGHT = """pressed => {
    const { top, bottom } = document.activeElement.getBoundingClientRect();
    return document.activeElement.ariaPressed === pressed && top >= 0 && bottom <= innerHeight;
}"""


def test_sweeps_are_found_sorted_pinned_and_deleted(browser: Any, many: str):
    with opened(browser, many) as page:
        page.get_by_text("1 to 25 of 30").wait_for()
        pin = page.get_by_role("button", name="Pin number 06")
        for pressed in ("true", "false"):  # the row moves up and back; the focus stays in sight
            pin.press("Enter")
            page.wait_for_function(IN_SIGHT, arg=pressed)
        for is_pinned in (True, False):  # by a pointer: the page is not scrolled to the row
            pin.dispatch_event("click", {"detail": 1})
            page.locator("#status", has_text=f"number 06 is {'' if is_pinned else 'un'}pinned.").wait_for()
            assert (pin.bounding_box()["y"] < 0) is is_pinned
        page.get_by_role("button", name="Next page").click()
        page.get_by_text("26 to 30 of 30").wait_for()
        _wait_names(page, *(f"number {n:02}" for n in (4, 3, 2, 1, 0)))
        page.wait_for_url(re.compile("pages="))
        page.get_by_role("link", name="number 02").click()
        page.get_by_role("heading", name="number 02").wait_for()
        page.go_back()
        page.get_by_text("26 to 30 of 30").wait_for()
        page.get_by_label("Order").select_option("by name")
        page.get_by_text("1 to 25 of 30").wait_for()
        assert _names(page)[0] == "number 00"
        page.get_by_label("Find", exact=True).fill("NUMBER 1")
        page.get_by_label("Contact").select_option("soft")
        page.get_by_text("5 sweeps found").wait_for()
        found = [f"number {n}" for n in (11, 13, 15, 17, 19)]
        _wait_names(page, *found)
        page.wait_for_function("() => location.hash.includes('search=NUMBER+1')")
        page.get_by_role("button", name="Pin number 15").click()
        _wait_names(page, found[2], *found[:2], *found[3:])
        page.reload()  # the address holds what is looked for
        _wait_names(page, found[2], *found[:2], *found[3:])
        page.get_by_label("Select number 11").check()
        page.get_by_label("Select number 15").check()
        page.get_by_text("2 selected").wait_for()
        page.get_by_role("button", name="Pin number 15").click()
        _wait_names(page, *found)
        questions: list[str] = []
        page.once("dialog", lambda dialog: (questions.append(dialog.message), dialog.accept()))
        page.locator(".selection").get_by_role("button", name="Delete").click()
        assert questions[0].startswith("Delete 2 sweeps and their results: “number 1")
        _wait_names(page, found[1], *found[3:])
        page.get_by_role("link", name="Sweeps", exact=True).click()  # all of them
        page.get_by_text("1 to 25 of 28").wait_for()
        assert page.get_by_label("Find", exact=True).input_value() == ""
        page.get_by_role("button", name="Next page").click()
        page.get_by_text("26 to 28 of 28").wait_for()
        page.get_by_label("Select all shown").check()
        page.once("dialog", lambda dialog: dialog.accept())
        page.locator(".selection").get_by_role("button", name="Delete").click()
        wait_for(lambda: len(_names(page)) == 25)  # the page before


#: The line about each specification, in the list, the bar and comparisons.
_SUMMARIES = """(specs) => import(new URL("static/js/views/progress.js", location)).then(({ summary }) =>
    specs.map((spec) => summary({ spec }).map((part) => part.textContent ?? part).join("")))"""


def test_studies_are_told_apart_by_contact_exponents_and_plane(browser: Any, many: str):
    sweep = {"gamma": 1, "omega": 0.5, "xi": 0.2, "protocol": {"kind": "rest"}, "exponents": 0}
    soft = {"kind": "soft", "restitution": 0.2, "penetration": 0.01, "rest_length": None, "adhesive": True}
    plane = {"kind": "basin", "plane": "contact", "rows": 32, "columns": 48}
    specs = [
        sweep | {"model": {"kind": "rigid", "restitution": 0.0}, "exponents": 2},
        sweep | {"model": soft},
        sweep | {"model": soft | {"penetration": None, "rest_length": 9.0, "adhesive": False}},
        sweep | {"model": soft, "protocol": plane},
    ]
    with opened(browser, many) as page:
        said = page.evaluate(_SUMMARIES, specs)
    assert [text.removeprefix("Γ 1 · Ω 0.5 · ξ 0.2 · ").replace("\xa0", " ") for text in said] == [
        "from rest · rigid, e 0 · 2 exponents",
        "from rest · soft, e 0.2, d 0.01",
        "from rest · soft, e 0.2, Λ 9, never pulling",
        "basin, 48 × 32 starts in contact · soft, e 0.2, d 0.01",
    ]


def test_copied_texts_are_the_specification(browser: Any, address: str, jobs: list[str], tmp_path: Path):
    """Python, TOML and JSON, read back, are the same sweep: the same job. The origin stands beside them."""
    with opened(browser, f"{address}/#/job/{jobs[0]}/details") as page, Client(address) as client:
        origin = page.get_by_role("region", name="Origin of the sweep")
        origin.get_by_text(re.compile(r"numpy \d")).wait_for()
        assert jobs[0] in origin.inner_text()
        assert re.search(r"Core-seconds\s+[\d.]+", origin.inner_text())
        for name, read in {"TOML": tomllib.loads, "Python": _as_python, "JSON": json.loads}.items():
            page.get_by_label("Language").select_option(name)
            assert client.submit(read(page.locator(".snippets pre").inner_text())).id == jobs[0], name


def test_copied_python_draws_every_kind_of_study(
    browser: Any, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)  # where pictures are written
    two: dict[str, Any] = {"omega": [0.5, 0.6], "xi": [0.05, 0.1]}
    plane = {"gamma": [1.0, 1.5], **two, "settle": 40, "observe": 12, "keep": 8}
    starts = {"rows": 2, "columns": 2}
    for spec, expected in (
        (plane, "plot(xi=0.1)"),
        (two | {"protocol": {"kind": "orbits"}, "modes": ["1-1"]}, "plot(omega=0.6, xi=0.1)"),
        (plane | {"protocol": {"kind": "multistability", **starts}}, '"png", xi=0.1'),
        (plane | {"gamma": 1.5, "protocol": {"kind": "basin", **starts}}, '"png", omega=0.6, xi=0.1'),
    ):
        job = done(address, {"name": "copied", **spec})
        with opened(browser, f"{address}/#/job/{job}/details") as page:
            page.get_by_label("Language").select_option("Python")
            text = page.locator(".snippets pre").inner_text()
        assert expected in text
        exec(text, {})
    assert {path.name for path in tmp_path.iterdir()} == {"basins.png", "multistability.png"}


def test_a_sweep_is_audited_from_its_details(browser: Any, address: str, jobs: list[str], tmp_path: Path):
    with opened(browser, f"{address}/#/job/{jobs[0]}/details") as page, Client(address) as client:
        page.get_by_role("button", name="Audit this sweep").click()
        page.get_by_role("region", name="Audit by question").wait_for()
        audit = client.job(jobs[0]).audit(progress=False)
        sentence = audit.attrs["sentence"]
        texts = page.get_by_role("region", name="Audit by question").locator("td").all_inner_texts()
        low, high = (float(text.removesuffix(" %")) / 100 for text in texts[4:6])
        assert low <= audit.low.values.flat[0] <= audit.high.values.flat[0] <= high
        assert page.get_by_text(f"{sentence}.").is_visible()
        shared = client.job(jobs[0]).share(tmp_path / "shared.html").as_uri()
    size = {"width": 1280, "height": 800}
    with opened(browser, f"{shared}#/job/{jobs[0]}/details", offline=True, viewport=size) as page:
        page.get_by_role("row", name="Note").get_by_text(sentence).wait_for()
        assert page.locator(".settling", has_text=sentence).bounding_box()["height"] < 30  # in one line


def test_a_cell_that_an_audit_changes_is_shown_at_its_frequency(browser: Any, address: str):
    job = done(address, spec_of((2.0, 6.0, 40), [0.5, 1.0], 0.05, window=(3, 6, 8), name="Too short"))
    with opened(browser, f"{address}/#/job/{job}/details") as page:
        page.get_by_role("button", name="Audit this sweep").click()
        page.locator("#status", has_text="Auditing …").wait_for()
        page.locator("summary", has_text="that changed").click()
        page.locator("li a", has_text="Ω = 0.5,").last.click()
        wait_shown(page, omega=0.5)
        assert page.evaluate("scrollY") == 0  # the link is far below


def _as_python(text: str) -> Any:
    (spec,) = (node.value for node in ast.parse(text).body if isinstance(node, ast.Assign))
    return ast.literal_eval(spec)


def test_sweeps_are_compared_with_linked_axes(browser: Any, address: str, jobs: list[str]):
    with opened(browser, address) as page:
        page.get_by_label("Find", exact=True).fill("sweep 0")
        wait_for(lambda: page.get_by_label(re.compile(r"^Select sweep")).count() == 3)
        for xi in (0.05, 0.1, 0.2):
            page.get_by_label(f"Select sweep {xi}").check()
        page.get_by_role("button", name="Compare").click()
        wait_shown(page, along="gamma")
        plots = page.locator(".panel .plot")
        assert plots.count() == 1
        plots.first.hover()
        page.locator(".readout .entry", has_text="sweep: sweep 0.2 · Ω = 0.6 · ξ = 0.2").wait_for()
        texts = page.locator(".panel .plot").inner_text()
        assert all(text in texts for text in ("Ω = 0.6", "sweep 0.05, ξ = 0.05", "sweep 0.1, ξ = 0.1"))
        page.get_by_label("Layout").select_option("side by side")
        assert plots.count() == 3
        page.locator(".panel .plot[data-shown]").nth(2).wait_for()
        page.locator("figure").nth(1).locator(".plot").focus()
        page.keyboard.press("+")
        page.wait_for_function("() => location.hash.includes('x0=')")
        page.keyboard.press("ArrowRight")
        for readout in page.locator(".readout").all():  # the others follow
            assert readout.inner_text().startswith("Γ = ")
        table = pandas.read_csv(download(page.get_by_role("button", name="Download CSV").nth(1)))
        assert set(table.xi) == {0.1}
        page.go_back()
        page.get_by_role("button", name="Show all").first.wait_for(state="hidden")
        assert plots.count() == 3


def test_a_comparison_says_what_only_some_of_its_sweeps_have(browser: Any, address: str, jobs: list[str]):
    certified = done(address, spec_of((0.5, 3.0, 6), 0.5, 0.26, name="certified"))
    for order in ([certified, jobs[0]], [jobs[0], certified]):
        with opened(browser, f"{address}/#/compare?jobs={','.join(order)}") as page:
            wait_shown(page, along="gamma")
            page.locator(".panel .plot").press("ArrowRight")
            for name, text in (("certified", "|μ|: 0."), ("sweep 0.05", "flight times")):
                page.locator(".readout .entry", has_text=f"sweep: {name}").filter(has_text=text).wait_for()


#: A map of two directions and one from rest, over different ranges.
MAPS = (
    spec_of((0.6, 1.6, 12), (0.5, 0.8, 5), [0.05, 0.1], "both", (30, 10, 8), name="both ways"),
    spec_of((1.0, 3.0, 21), [0.5, 0.7, 0.9], [0.05, 0.1], window=(30, 10, 8), name="from rest"),
)


def test_mode_maps_are_compared_with_linked_axes(browser: Any, address: str):
    with Client(address) as client:
        maps = [client.submit(spec).wait(progress=False).id for spec in MAPS]
    with opened(browser, f"{address}/#/compare?jobs={','.join(maps)}") as page:
        wait_shown(page, along="gamma")
        page.get_by_label("Layout").select_option("mode maps")
        wait_shown(page, xi=0.1, direction="up")
        page.locator(".panel .plot[data-shown]").nth(1).wait_for()
        plots = page.locator(".panel .plot")
        titles = [plot.get_attribute("aria-label").split(".")[0] for plot in plots.all()]
        assert titles == ["Mode map of both ways", "Mode map of from rest"]
        plots.first.focus()
        for key in ("Shift+ArrowLeft", "ArrowRight", "Shift+ArrowRight"):
            page.keyboard.press(key)
        first, second = (readout.inner_text() for readout in page.locator(".readout").all())
        assert "Γ = 1.6 · Ω = 0.65" in first
        assert "Γ = 1.6 · Ω = 0.7" in second
        page.keyboard.press("+")
        page.wait_for_function("() => location.hash.includes('x0=')")
        table = download(page.get_by_role("button", name="Download CSV").nth(1)).read_text()
        assert len(table.splitlines()) == 1 + 3 * 13  # of the window


def test_the_difference_of_two_sweeps_is_a_map_and_a_sentence(browser: Any, address: str, jobs: list[str]):
    names = ("outcome", "bounces", "periods")
    with Client(address) as client:
        first, second = (client.job(id).modes() for id in jobs[:2])
        ends = [client.job(id).threshold(predict="none") for id in jobs[:2]]
    same = np.logical_and.reduce([first[name].values == second[name].values for name in names])
    moved = float(abs(ends[0].up - ends[1].up).max())
    with opened(browser, f"{address}/#/compare?jobs={','.join(jobs[:2])}&layout=difference") as page:
        sentence = page.locator(".sentence", has_text="of the cells have the same mode")
        sentence.wait_for()
        said = re.fullmatch(
            r"At ξ = .* against .*, ([\d.]+) % .*; no threshold in both moves(?: by more than ([\d.]+))?\.",
            sentence.inner_text(),
        )
        assert said is not None
        numbers = [float(text or 0) for text in said.groups()]
        assert numbers == pytest.approx([100 * same.mean(), moved], rel=0.05)
        page.get_by_text("Table of what is shown").click()
        page.locator(".paged [role=status]", has_text=f"of {np.count_nonzero(~same)}").wait_for()
        at_rest = second.outcome.values == Outcome.AT_REST
        listed = page.locator(".legend li", has_text="at rest").count()
        assert (listed, at_rest.any()) == ((at_rest & ~same).any(), True)  # of the cells that differ


def test_the_difference_of_two_lines_has_one_frequency(browser: Any, address: str):
    line = spec_of((0.5, 3.0, 26), 0.45, 0.05, ramp="both", window=(40, 12, 8))
    lines = [done(address, {**line, "xi": xi}) for xi in (0.05, 0.1)]
    with opened(browser, f"{address}/#/compare?jobs={','.join(lines)}&layout=difference") as page:
        page.locator(".sentence", has_text="of the cells have the same mode").wait_for()
        ticks = page.locator(".panel .plot .texts span").all_inner_texts()
        assert [text for text in ticks if text.startswith("0.4")] == ["0.45"]
        with page.expect_request(re.compile("/difference.*direction=down")):
            page.get_by_label("Ramp").select_option("down")


def test_a_spring_is_explored_without_a_sweep(browser: Any, address: str):
    with opened(browser, f"{address}/#/explore") as page:
        page.locator(".plot[data-shown] .texts", has_text="rigid, restitution 0").wait_for(state="attached")
        page.get_by_text("Bouncing does not persist below").wait_for()
        page.locator(".player[data-phase]").wait_for()
        page.get_by_text(re.compile(r"\d+ points? of \d+ pairs of flights")).wait_for()
        assert page.locator(".panel .plot").bounding_box()["y"] < 140
        page.get_by_label("Value of Ω").fill("5")
        page.get_by_label("Value of Ω").press("Enter")
        page.wait_for_function("() => document.activeElement.validationMessage.includes('from 0.12 to 2')")
        page.get_by_label("Value of Ω").fill("0.6003")
        page.get_by_label("Value of ξ").fill("0.05")
        page.get_by_label("Value of ξ").press("Enter")
        page.wait_for_function("() => document.querySelector('.plot').dataset.shown.includes('0.6003')")
        page.wait_for_function("() => location.hash.includes('omega=0.6003')")
        shown = float(re.findall(r"Rest ends at Γ = ([\d.]+)", page.locator(".closed").inner_text())[0])
        assert shown == pytest.approx(float(threshold(0.6003, 0.05)), rel=1e-3)
        events = closed_form_events(0.6003, 0.05)
        rows = page.locator("table tbody tr")
        wait_for(lambda: rows.count() == len(events))
        table = pandas.read_csv(download(page.get_by_role("button", name="Download table as CSV")))
        assert table["Γ"].tolist() == pytest.approx(events, rel=1e-6)
        plot = page.locator(".panel .plot")
        plot.focus()
        plot.press("ArrowUp")
        readout = page.locator(".panel .readout").inner_text()
        assert re.match(r"Γ = 2\.[23]\d* · cycle \(1, 1\), (un)?stable · flight time", readout)
        plot.press("Enter")
        flight = re.findall(r"flight time ([\d.]+)", readout)[0]
        page.locator(".trajectory .readout", has_text=f"flight time {flight}").wait_for()
        page.get_by_label("Cycles up to").select_option("1")
        wait_for(lambda: 0 < rows.count() < len(events))
        page.get_by_label("Contact").select_option("soft")
        page.locator(".closed", has_text="Bouncing does not persist below Γ = 0.55").wait_for()
        page.wait_for_url(re.compile("contact=soft"))
        depth = page.get_by_label("depth")
        assert depth.input_value() == "0.001"
        depth.fill("0,2")
        depth.press("Enter")
        assert depth.evaluate("input => input.validationMessage").endswith("comma: 0.2")
        assert "penetration" not in page.url
        page.get_by_role("link", name="New sweep around this spring").click()
        page.locator(".cost", has_text="cells in").wait_for()
        assert page.get_by_label("contact model").input_value() == "soft"
        assert page.locator("[data-field=omega]").first.input_value() == "0.6003"
        reopen(page, f"{address}/#/explore?contact=soft&penetration=0.01&omega=5")
        page.locator(".closed", has_text="Ω = 5 is outside the limits; 2 is shown.").wait_for()
        assert page.get_by_label("depth").input_value() == "0.01"
        page.get_by_role("link", name="Explore", exact=True).click()
        page.get_by_label("depth").wait_for(state="detached")
        assert page.get_by_label("Contact").input_value() == "ideal"


def closed_form_events(omega: float, xi: float) -> list[float]:
    """The Γ below 8 of the events of cycles (1, 1) to (1, 3) that the spring has."""
    found = [branch_and_events(omega, xi, periods)[1] for periods in (1, 2, 3)]
    gammas = [gamma for events in found for gamma in events.gamma[events.violations == 0]]
    return sorted(float(gamma) for gamma in gammas if gamma <= 8.0)


def test_files_tell_where_they_come_from(browser: Any, address: str, jobs: list[str], tmp_path: Path):
    job = jobs[0]
    with opened(browser, f"{address}/#/job/{job}/diagram?omega=0.5", expected=("net::ERR_",)) as page:
        wait_shown(page, along="gamma")

        def saved(label: str) -> bytes:
            return download(page.get_by_role("button", name=f"Download {label}", exact=True)).read_bytes()

        with Image.open(io.BytesIO(saved("PNG"))) as image:
            image.load()
            assert job in "".join(map(str, image.info.values()))
        assert job in saved("SVG").decode()
        assert saved("PDF").startswith(b"%PDF")
        assert saved("NetCDF").startswith(b"\x89HDF")
        captioned = len(saved("SVG"))
        page.get_by_label("with a caption").uncheck()
        assert len(saved("SVG")) < captioned
        page.route("**/diagram?*format=csv", lambda route: route.abort())
        with page.expect_event("requestfailed"):
            page.get_by_label("Download CSV").first.click()
        page.locator("[aria-label='Download CSV']:enabled").first.wait_for()  # the banner told it
        assert page.locator(".panel .downloads [role=status]").first.inner_text() == ""
        window = "x0=0.55&x1=2&y0=0.4&y1=6&hide=3,99"
        for tab, shown in (
            ("diagram", "start=0.55&stop=2&flight_start=0.4&flight_stop=6&log=none&hide=at_rest"),
            ("modes", "gamma_start=0.55&gamma_stop=2&omega_start=0.4&omega_stop=6&log=none&hide=at_rest"),
            ("thresholds", "omega_start=0.55&omega_stop=2&gamma_start=0.4&gamma_stop=6"),
        ):
            reopen(page, f"{address}/#/job/{job}/{tab}?omega=0.5&{window}")
            wait_shown(page, xi=0.05)
            with page.expect_request(re.compile("format=svg")) as request:
                saved("SVG")
            assert shown in request.value.url
            assert "hold everything" not in page.locator(".panel .downloads").first.inner_text()
        reopen(page, f"{address}/#/job/{job}/modes")
        wait_shown(page, direction="rest")
        ours = saved("CSV")
    theirs = tmp_path / "modes.csv"
    done = CliRunner().invoke(main, ["modes", job, "-o", str(theirs), "--url", address])
    assert done.exit_code == 0, done.output
    rows, cells = (pandas.read_csv(io.BytesIO(content)) for content in (ours, theirs.read_bytes()))
    pandas.testing.assert_frame_equal(rows, cells[rows.columns])
