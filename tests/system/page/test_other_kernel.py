"""The page on sweeps of another kernel version: it says so, and leads to the sweep that replaces one."""

from pathlib import Path

from browser import chromium, needs_chromium, opened, reopen, wait_shown
from earlier_kernel import IDS, earlier_folder
from scripted import Held
from served import service_at

from kernel.params import KERNEL_VERSION
from service.client import Client

pytestmark = needs_chromium

NOTICE = f"Computed by kernel version 1; this release computes version {KERNEL_VERSION}"


def test_the_page_says_which_kernel_computed_a_sweep_and_follows_to_its_replacement(tmp_path: Path):
    done, interrupted = (IDS[name] for name in ("done", "interrupted"))
    with (
        service_at(earlier_folder(tmp_path), Held()) as address,
        Client(address) as client,
        chromium() as browser,
        opened(browser, f"{address}/#/job/{done}/diagram?omega=0.5") as page,
    ):
        new = client.job(interrupted).replaced_by
        wait_shown(page, omega=0.5)  # the results of then are drawn
        assert page.locator("header.job .notice:not(.settling)").inner_text() == f"{NOTICE}."
        page.goto(f"{address}/#/")
        rows = page.locator(".jobs li")
        rows.nth(3).wait_for()
        notices = [row.locator(".notice").inner_text() for row in rows.all()]
        replaced = f"{NOTICE}, as job {new}. Show the sweep that replaces it"
        assert notices == ["", f"{NOTICE}.", replaced, f"{NOTICE}."]
        page.get_by_role("link", name="Show the sweep that replaces it").click()
        page.wait_for_url(f"**/#/job/{new}**")
        reopen(page, f"{address}/#/job/{interrupted}")
        page.get_by_role("button", name="Resume up and down").click()
        page.wait_for_url(f"**/#/job/{new}**")
        page.get_by_role("button", name="Cancel up and down").wait_for()
        assert page.locator("header.job .notice:not(.settling)").is_hidden()
