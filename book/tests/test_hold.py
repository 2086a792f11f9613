"""Test the apron that a reader holds in a real browser without a network: by keys, mouse and touch, on a phone, in the dark.

    make check-book

The page is made by the Python of `.venv`, or of TOPOKIT_PYTHON.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
from test_cloud import PYTHON
from test_in_browser import CHROMIUM, OVERFLOW, ROOT, SETTLED, Visit, chromium  # noqa: F401

pytest.importorskip("playwright", reason="Playwright is not installed: make check-book")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium")
MAKE = """
import sys
from chapter_tools import figures
from topokit.io import load_episode
figures.hold(load_episode("data_small/apron_hook_0.npz")).save(sys.argv[1])
"""
SAYS = "(text) => document.querySelector('#status').textContent.includes(text)"
LINKED = "goes around the hook (linking number 1)"
HANDLE = (230, 43)  # of both hands, at a width of 1000


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("hold") / "hold.html"
    places = {"PYTHONPATH": f"{ROOT}:{ROOT / 'notebooks'}"}
    subprocess.run([PYTHON, "-c", MAKE, path], cwd=ROOT, env=places, check=True)
    return str(path)


def waits(visit: Any, text: str) -> None:
    visit.page.wait_for_function(SAYS, arg=text, timeout=90_000)


def test_the_apron_is_hung_by_keys(chromium: Any, page: str) -> None:  # noqa: F811
    with Visit(chromium, page, 1000) as visit:
        visit.page.focus("#scene")
        for key, count in (("ArrowRight", 27), ("ArrowDown", 5)):
            for _ in range(count):
                visit.page.keyboard.press(key)
        waits(visit, LINKED)
        visit.page.wait_for_timeout(2000)
        visit.page.keyboard.press("Space")
        waits(visit, "It hangs")
        for _ in range(4):
            visit.page.keyboard.press("Tab")
        assert visit.ask("() => document.activeElement.id") != "scene"  # the hands do not keep the focus
        assert visit.trouble == []


@pytest.mark.parametrize("touch", [False, True])
def test_the_apron_is_dragged_and_dropped(chromium: Any, page: str, touch: bool) -> None:  # noqa: F811
    with Visit(chromium, page, 1000, has_touch=touch) as visit:
        visit.page.set_viewport_size({"width": 1000, "height": 640})
        waits(visit, "Loop 0")
        visit.ask(SETTLED)
        x, y = HANDLE
        if touch:
            point = visit.context.new_cdp_session(visit.page)
            for kind, dx in (("touchStart", 0), *(("touchMove", 5 * k) for k in range(34)), ("touchEnd", None)):
                places = [] if dx is None else [{"x": x + dx, "y": y}]
                point.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})
        else:
            visit.page.mouse.move(x, y)
            visit.page.mouse.down()
            visit.page.mouse.move(x + 165, y, steps=30)
            visit.page.mouse.up()
        waits(visit, LINKED)
        visit.page.click("#again")
        visit.page.click("#release")
        waits(visit, "It fell")
        assert visit.trouble == []


def test_the_ready_script_hangs_it_and_the_tracker_can_be_fooled(chromium: Any, page: str) -> None:  # noqa: F811
    with Visit(chromium, page, 1000, reduced_motion="reduce") as visit:
        visit.page.select_option("#goal", "few")
        visit.page.click("#script")
        waits(visit, "The same moves in PyBullet")
        waits(visit, "It hangs")
        with visit.page.expect_download() as download:
            visit.page.click("#save")
        assert Path(download.value.path()).read_bytes().startswith(b"\x93NUMPY")
        visit.page.click("#again")
        visit.page.select_option("#goal", "fool")
        waits(visit, "Not fooled yet")
        visit.page.click("#release")
        waits(visit, "fooled")
        assert visit.trouble == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_fits_on_a_phone_and_can_be_used_by_all(chromium: Any, page: str, scheme: str) -> None:  # noqa: F811
    with Visit(chromium, page, 400, color_scheme=scheme) as visit:
        visit.page.set_viewport_size({"width": 400, "height": 800})
        waits(visit, "Loop 0")
        assert not visit.ask(OVERFLOW)
        assert visit.ask("() => document.querySelector('#status').getBoundingClientRect().bottom") <= 800
        assert visit.violations() + visit.trouble == []
