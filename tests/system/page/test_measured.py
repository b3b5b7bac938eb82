"""Measured points dropped on a plot, in a real Chromium: their residual is that of the diagram below them."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from browser import DROP, download, needs_chromium, open_tab, opened, picture, wait_shown
from scripted import wait_for
from served import computing_at, done
from studies import spec_of

from service.client import Client

pytestmark = needs_chromium

SWEEP = spec_of((0.5, 1.4, 46), [0.5, 0.6, 0.7], 0.05, name="Measured", ramp="both", window=(120, 30, 24))


def test_measured_flights_are_drawn_with_their_residual(browser: Any, address: str, tmp_path: Path):
    job = done(address, SWEEP)
    with Client(address) as client:
        line = client.job(job).diagram(omega=0.6).sel(direction="down")
    bouncing = line.isel(gamma=(line.flights > 0).values)
    gamma, time = bouncing.gamma.values[::3], np.nanmax(bouncing.flight_time.values[::3], axis=1)
    hertz, off = 25.0, np.linspace(0.01, 0.03, len(gamma))
    flight_time_ms = (time + off) * 1000 / (2 * math.pi * hertz)
    rows = [f"{x},0.6,{y},{hertz},0.5" for x, y in zip(gamma, flight_time_ms, strict=True)]
    names = "gamma, omega, flight_time_ms, frequency, error"  # thresholds have columns of these names
    table = "\n".join(["# of a run", names, *rows, f"2.5,0.6,30,{hertz},"])
    with opened(browser, f"{address}/#/job/{job}/diagram?omega=0.6&show=down") as page:
        wait_shown(page, omega=0.6)
        for text, problem in (
            ("gamma,speed\n1,2", "run.csv: speed is no column here; these are gamma, omega"),
            ("gamma,flight_time\r1,4\r1,0x4", "row 2 must be a number of 0 or more, not '0x4'"),
            ("\0".join("gamma,flight_time\n1,4\n"), "run.csv: is no text in UTF-8."),
            ("gamma,flight_time\n1,4\n1,5,4,2", "run.csv: row 2 has more cells than there are columns"),
            ("gamma,flight_time,frequency\n1,4,0", "frequency of row 1 must be a number above 0"),
        ):
            page.evaluate(DROP, ["run.csv", text])
            page.locator(".problem", has_text=problem).wait_for()
        page.evaluate(
            DROP, ["run.csv", 'gamma,"omega\n",flight_time,\n1,0.6,"\n4",\n1,0.9,4\n1,n/a,4 # 5" of']
        )
        page.locator(".measured", has_text=re.compile("2 of 2 points.*; 1 of another Ω or ξ left")).wait_for()
        page.get_by_text("Measured points", exact=True).press("Enter")
        (tmp_path / "run.csv").write_text(table)
        page.get_by_label("A CSV file whose columns are some of gamma, omega").set_input_files(
            tmp_path / "run.csv"
        )
        said = page.locator(".measured", has_text=f"run.csv: {len(rows)} of {len(rows) + 1} points")
        said.wait_for()
        assert f"median residual {np.median(off):.2g} rad, largest 0.03 rad" in said.inner_text()
        assert page.locator(".panel > aside .problem").first.is_hidden()
        page.locator(".downloads", has_text="SVG and PDF lack the measured points.").wait_for()
        open_tab(page, "Thresholds")
        wait_shown(page, xi=0.05)
        assert said.is_hidden()
        page.evaluate(DROP, ["thresholds.csv", "omega,gamma\n0.6,0.7\n"])
        text = "thresholds.csv: 1 of 1 point where computed ones are shown, median residual 0."
        page.locator(".measured", has_text=text).wait_for()
        shared = download(page.get_by_role("button", name="Download a page to share"))
        shared = shared.rename(tmp_path / shared.name)  # closed with the page, it is gone
        open_tab(page, "Diagram")  # the page keeps them
        assert page.locator("#status").inner_text().endswith("is downloaded.")
        said.get_by_role("button", name="remove").press("Enter")
        said.wait_for(state="hidden")
        with page.expect_file_chooser() as chosen:  # from where the focus went; the same file, edited
            page.locator("summary:focus").press("Enter")
            page.keyboard.press("Tab")
            page.keyboard.press("Enter")
        (tmp_path / "run.csv").write_text("gamma,flight_time\n1,4\n")
        chosen.value.set_files(tmp_path / "run.csv")
        page.locator(".measured", has_text="run.csv: 1 of 1 point").wait_for()
    with opened(browser, f"{shared.as_uri()}", offline=True) as page:
        page.locator(".measured", has_text=f"run.csv: {len(rows)} of {len(rows) + 1} points").wait_for()
        open_tab(page, "Thresholds")
        page.locator(".measured", has_text="thresholds.csv: 1 of 1 point").wait_for()


def test_an_error_that_reaches_below_zero_is_drawn_on_a_logarithmic_axis(browser: Any, address: str):
    with opened(browser, f"{address}/#/job/{done(address, SWEEP)}/diagram?omega=0.6&log=y") as page:
        wait_shown(page, omega=0.6)
        page.evaluate(DROP, ["error.csv", "gamma,flight_time\n1,4"])
        page.locator(".measured", has_text="error.csv: 1 of 1 point").wait_for()
        bare = picture(page)
        page.evaluate(DROP, ["error.csv", "gamma,flight_time,error\n1,4,9"])
        wait_for(lambda: picture(page) != bare)


def test_points_beyond_the_window_of_a_long_line_have_no_residual(browser: Any, tmp_path: Path):
    with computing_at(tmp_path, max_points=1000) as address:
        job = done(address, SWEEP | {"keep": 24, "omega": 0.6, "protocol": {"kind": "rest"}})
        with opened(browser, f"{address}/#/job/{job}/diagram", expected=("413",)) as page:
            wait_shown(page, every=2)
            page.evaluate(DROP, ["run.csv", "gamma,flight_time\n0.95,3\n1.4,4"])
            page.locator(".measured", has_text="run.csv: 2 of 2 points").wait_for()
            page.locator(".panel .plot").focus()
            for _ in range(3):
                page.keyboard.press("+")
            wait_shown(page, every=1)
            page.locator(".measured", has_text="run.csv: 1 of 2 points").wait_for()
