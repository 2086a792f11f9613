"""Test the built book in a real browser without a network: every page, both themes, two widths, every control.

    make check-book

Playwright drives the system's own Chromium and downloads nothing. axe-core, from axe-playwright-python, checks accessibility.
Without Chromium, Playwright or a built book the tests are skipped with the command that is missing.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
BOOK = Path(os.environ.get("TOPOKIT_BOOK", ROOT / "_build" / "html")).resolve()
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
MOVED = [page for page in BOOK.glob("notebooks/*.html") if 'http-equiv="refresh"' in page.read_text(encoding="utf-8")]
PAGES = sorted(page.relative_to(BOOK).as_posix() for page in BOOK.glob("[!_]*/**/*.html") if page not in MOVED) + [
    "genindex.html",
    "search.html",
]
CHAPTERS = [page for page in PAGES if page.startswith("notebooks/")]

pytest.importorskip("playwright", reason="Playwright is not installed: make check-book")
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium"),
    pytest.mark.skipif(not CHAPTERS, reason=f"no book in {BOOK}: make book"),
]

# Rows and entries after the first few are made as those are, so is code of one colour; the shapes of a drawing are one picture.
REPEATED = (
    ".topokit-plot svg > g",
    "tr:nth-child(n+4)",
    "dl.py ~ dl.py",
    ".toc-entry ~ .toc-entry",
    "p ~ p ~ p",
    ".cell ~ .cell",
    "details ~ details",
)
# They are removed from a page before axe-core reads it, which would take many times longer to leave them out.
PRUNE = """(repeated) => {
  for (const formula of document.querySelectorAll(".katex")) formula.replaceWith("x");
  for (const part of document.querySelectorAll(repeated)) if (!part.querySelector("iframe")) part.remove();
  const kinds = new Set();
  for (const code of document.querySelectorAll("pre span")) {
    const kind = `${code.className} in ${code.closest("div").className}`;
    if (kinds.has(kind) || !code.checkVisibility()) code.remove();
    else kinds.add(kind);
  }
}"""
SETTLED = "async () => { for (let i = 0; i < 2; i++) await new Promise(requestAnimationFrame); }"
# The state of a figure: its canvases, its status line, and whether its keys are explained.
SHOWN = """() => [...document.querySelectorAll("canvas")].map((c) => c.toDataURL()).join()
  + document.querySelector("#status")?.textContent + document.querySelector("#keys")?.hidden"""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    options = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield browser
        browser.close()


class Visit:
    """A page opened without a network, and the errors on it."""

    def __init__(self, chromium: Any, page: str, width: int = 1280, asking: str = "", **options: Any) -> None:
        self.context = chromium.new_context(viewport={"width": width, "height": 900}, offline=True, **options)
        self.page = self.context.new_page()
        self.trouble: list[str] = []
        self.page.on("console", lambda m: m.type in ("error", "warning") and self.trouble.append(f"console: {m.text}"))
        self.page.on("pageerror", lambda error: self.trouble.append(f"error: {error}"))
        self.page.on("requestfailed", lambda request: self.trouble.append(f"failed: {request.url}"))
        self.page.on("request", self._leaves)
        self.page.goto((BOOK / page).as_uri() + asking, wait_until="load")

    def _leaves(self, request: Any) -> None:
        if request.url.split(":")[0] not in ("file", "data", "blob", "about"):
            self.trouble.append(f"asks the network: {request.url}")

    def ask(self, script: str, *given: Any) -> Any:
        return self.page.evaluate(script, *given)

    def theme(self, name: str) -> None:
        self.ask(THEME, name)

    def figures(self) -> list[Any]:
        """Return the frames of the interactive figures, each scrolled to, so that it has been loaded and drawn."""
        frames = []
        for element in self.page.query_selector_all("iframe[srcdoc]"):
            if element.is_visible():  # not those in a folded solution
                element.scroll_into_view_if_needed()
                frame = element.content_frame()
                frame.wait_for_selector("main, svg", state="attached")
                frame.evaluate(SETTLED)
                frames.append(frame)
        return frames

    def violations(self, *rules: str) -> list[str]:
        """Return what axe-core rates serious or critical, on the page and in its figures; the page is pruned for it."""
        axe = resources.files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8")
        options: dict[str, Any] = {"resultTypes": ["violations"], "preload": False, "iframes": False}
        if rules:
            options["runOnly"] = list(rules)
        found = []
        frames = [self.page.main_frame, *self.figures()]
        self.ask(PRUNE, ", ".join(REPEATED))
        for frame in frames:
            frame.evaluate(axe)
            result = frame.evaluate("(options) => axe.run(options)", options)
            for rule in result["violations"]:
                if rule["impact"] in ("serious", "critical"):
                    places = " | ".join(str(node["target"]) for node in rule["nodes"][:4])
                    found.append(f"{rule['id']} ({len(rule['nodes'])}): {places}")
        return found

    def __enter__(self) -> Visit:
        return self

    def __exit__(self, *error: object) -> None:
        self.context.close()


# Colours fade into those of the theme; wait until they have.
THEME = """async (name) => {
  document.documentElement.dataset.theme = document.documentElement.dataset.mode = name;
  await Promise.all(document.getAnimations().map((change) => change.finished));
}"""
OVERFLOW = """() => {
  const wide = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth <= wide) return [];
  const out = [...document.querySelectorAll("main *:not(.bd-sidebar-secondary, .bd-sidebar-secondary *)")]
    .filter((e) => e.getBoundingClientRect().right > wide + 1);
  return out.slice(0, 3).map((e) => e.tagName + "." + e.className + ": " + e.textContent.trim().slice(0, 60));
}"""
ON_SLIDE = "() => [...document.querySelectorAll('[data-slide=shown]')].at(-1).offsetHeight"
MATHS = """() => [...document.querySelectorAll(".math")]
  .filter((m) => !m.querySelector(".katex") || m.querySelector(".katex-error"))
  .map((m) => m.textContent.slice(0, 80))"""
# A wide formula is scrolled, from its beginning.
CUT = """() => [...document.querySelectorAll("div.math")].filter((m) => m.checkVisibility()
    && m.querySelector(".katex-html").getBoundingClientRect().left < m.getBoundingClientRect().left - 1)
  .map((m) => m.textContent.slice(0, 80))"""
# A picture needs an alt text, a drawing in the page a label; neither may be the name of a file.
TOLD = """() => [...document.querySelectorAll(".bd-article img, .bd-article svg[role=img]")].filter((e) => {
  const text = e.alt ?? e.getAttribute("aria-label") ?? "";
  const heard = !e.closest("[aria-hidden=true]") && (e.alt !== "" || !e.closest("a"));
  return heard && (text.trim().length < 12 || /\\.(png|svg|gif)$/.test(text));
}).map((e) => e.outerHTML.slice(0, 80))"""

# Output on stderr and tables that were not rendered do not belong on a page.
WARNED = """() => [...document.querySelectorAll(".output.stderr, .cell_output p")]
  .filter((e) => e.matches(".stderr") || e.textContent.startsWith("| ")).map((e) => e.textContent.slice(0, 200))"""


@pytest.mark.parametrize("page", PAGES)
def test_page(chromium: Any, page: str) -> None:
    with Visit(chromium, page) as visit:
        visit.figures()
        assert not visit.ask(OVERFLOW)
        assert not visit.ask(MATHS)
        assert not visit.ask(TOLD)
        assert not visit.ask(WARNED)
        assert "topokit" in visit.page.title()
        visit.page.set_viewport_size({"width": 400, "height": 800})
        assert not visit.ask(OVERFLOW)
        assert not visit.ask(CUT)
        for frame in visit.figures():
            assert not frame.evaluate(OVERFLOW)
        visit.page.set_viewport_size({"width": 1280, "height": 900})
        found = visit.violations()
        visit.theme("dark")
        found += [f"in the dark: {text}" for text in visit.violations("color-contrast")]
        assert found + visit.trouble == []


@pytest.mark.parametrize("page", PAGES)
def test_no_page_shows_where_it_was_built(page: str) -> None:
    assert str(ROOT) not in (BOOK / page).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", CHAPTERS)
def test_every_control_of_every_figure_does_something(chromium: Any, page: str) -> None:
    with Visit(chromium, page) as visit:
        dead = []
        for k, frame in enumerate(visit.figures()):
            before = frame.evaluate(SHOWN)
            for control in frame.query_selector_all("button, input, select, canvas[tabindex='0']"):
                if control.get_attribute("id") == "full":  # it would hide the others: a test of its own
                    continue
                if control.is_visible() and control.is_enabled():
                    if control.get_attribute("id") == "reset":  # there must be something to undo
                        _use(frame, frame.query_selector("canvas[tabindex='0']"))
                        before = frame.evaluate(SHOWN)
                    _use(frame, control)
                    after = frame.evaluate(SHOWN)
                    if after == before:
                        dead.append(f"figure {k}: {control.evaluate('e => e.outerHTML')[:120]}")
                    before = after
        assert dead + visit.trouble == []


@pytest.mark.parametrize("page", CHAPTERS)
def test_slides_show_one_thing_at_a_time(chromium: Any, page: str) -> None:
    with Visit(chromium, page, asking="?slides") as visit:
        count = int(visit.ask("() => document.querySelector('.topokit-turn output').textContent.split('/')[1]"))
        assert count >= 10
        seen = []
        for _ in range(count):
            seen.append(visit.ask(ON_SLIDE))
            assert visit.ask("() => [...document.querySelectorAll('[data-slide=note]')].every((e) => !e.offsetHeight)")
            assert not visit.ask(OVERFLOW)
            visit.page.keyboard.press("ArrowRight")
        assert all(height > 0 for height in seen), seen
        assert visit.trouble == []
        visit.page.keyboard.press("Escape")
        visit.page.wait_for_url((BOOK / page).as_uri())


ANSWERED = """(form, guess) => {
  form.querySelector("[name=guess]").value = guess;
  form.querySelector("button").click();
  return form.querySelector("output").innerText;
}"""


@pytest.mark.parametrize("page", CHAPTERS)
def test_a_guess_is_answered_on_the_page(chromium: Any, page: str) -> None:
    name = page.partition("/")[2]
    number = name[len("appendix_")].upper() if name.startswith("appendix_") else name.partition("_")[0]
    path = ROOT / "notebooks" / "chapter_tools" / "questions" / f"{number}.json"
    questions = json.loads(path.read_text("utf-8")).values() if path.exists() else ()  # a record asks nothing
    with Visit(chromium, page) as visit:
        forms = visit.page.query_selector_all(".topokit-question")
        by_why = {json.loads(form.get_attribute("data-question"))["why"]: form for form in forms}
        assert len(forms) == len(questions)
        for question in questions:
            form = by_why[question["why"]]
            said = {question["answer"]: f"Right. {question['why']}"}
            said |= {each["guess"]: f"Not yet. {each['remark']}" for each in question.get("wrong", ())}
            for guess, answer in said.items():
                assert form.evaluate(ANSWERED, str(guess)) == answer
        assert visit.trouble == []


def test_code_can_be_copied(chromium: Any) -> None:
    with Visit(chromium, "book/elsewhere.html", permissions=["clipboard-read", "clipboard-write"]) as visit:
        visit.page.locator(".topokit-copy").last.click()
        visit.page.get_by_text("copied").wait_for()
        copied = visit.ask("() => navigator.clipboard.readText()")
        assert copied == visit.page.locator(".topokit-code pre").last.text_content().rstrip()


@pytest.mark.parametrize("width", [1280, 400])
def test_a_figure_fills_the_screen_and_comes_back(chromium: Any, width: int) -> None:
    with Visit(chromium, "notebooks/10_a_world_of_aprons_bags_and_hooks.html", width) as visit:
        for frame in visit.figures():
            inside, button = frame.evaluate("innerWidth"), frame.query_selector("#full")
            if button is None:  # a picture
                continue
            for whole in (True, False):
                button.click()
                frame.wait_for_function(f"!!document.fullscreenElement === {str(whole).lower()}")
                frame.evaluate(SETTLED)
                assert button.get_attribute("aria-pressed") == str(whole).lower()
                assert frame.evaluate("innerWidth") == (width if whole else inside)
        assert visit.trouble == []


@pytest.mark.parametrize("page", [page for page in CHAPTERS if "data-shows" in (BOOK / page).read_text("utf-8")])
def test_words_light_up_their_part_of_one_figure(chromium: Any, page: str) -> None:
    with Visit(chromium, page) as visit:
        frames = visit.figures()
        for word in visit.page.query_selector_all("[data-shows]"):
            part, _, value = str(word.get_attribute("data-shows")).partition("=")
            word.focus()
            assert (
                sum(frame.evaluate("id => !!document.getElementById(id)?.closest('.lit')", part) for frame in frames)
                == 1
            )
            word.press("Enter")
            now = [frame.evaluate("id => document.getElementById(id)?.value", part) for frame in frames]
            assert not value or value in now, part
            word.press("Tab")
            assert not word.evaluate("e => e === document.activeElement")
        assert visit.trouble == []


def test_a_lit_part_of_the_complex_is_drawn(chromium: Any) -> None:
    drawn = "() => document.querySelector('#scene').toDataURL()"
    with Visit(chromium, "notebooks/01_point_clouds_and_rips_complexes.html") as visit:
        [figure, *_] = visit.figures()
        for part in ("birth", "killer", "cycle"):
            word, dark = visit.page.query_selector(f"[data-shows={part}]"), figure.evaluate(drawn)
            word.focus()
            figure.wait_for_function(f"(dark) => ({drawn})() !== dark", arg=dark)
            word.evaluate("e => e.blur()")
            figure.wait_for_function(f"(dark) => ({drawn})() === dark", arg=dark)
        assert visit.trouble == []


# A figure, how it is turned, what the library printed on the same page, and where the figure states the same number.
SET = """(e, value) => {
  e.value = value;
  e.dispatchEvent(new Event(e.type === "range" ? "input" : "change"));
}"""
TURNED = [
    ("00", "thinned", {"count": 100}, r"\n +100 +(\d+\.\d)", r"covering radius (\d+\.\d) mm"),
    ("00", "thinned", {"count": 551}, r"\n +551 +\S+ +(\d+)", r"(\d+) of 344 loops"),
    ("00", "thinned", {}, r"\n +200 +\S+ +(\d+)", r"(\d+) of \d+ loops"),
    ("00", "thinned", {}, r"\n +200 +\S+ +\S+ +(\d+\.\d)", r"longest lives (\d+\.\d) mm"),
    ("00", "thinned", {"count": 50}, r"\n +50 +\S+ +(\d+)", r"(\d+) of \d+ loops"),
    ("00", "thinned", {"count": 50, "alpha": 15}, r"50 points: (\d+) loops", r"(\d+) of \d+ loops"),
    ("05b", "hiding", {"keys": "n" * 7 + "E"}, r"killers (\d\.\d+) apart", r"(\d\.\d+) away, more than"),
    ("05b", "critical", {}, r"epsilon 0\.00: beta (\d\.\d\d)", r"\u03b2 = (\d\.\d+)"),
    ("05b", "critical", {"epsilon": 88}, r"epsilon 0\.08: beta (\d\.\d\d)", r"\u03b2 = (\d\.\d+)"),
    ("06", "verdicts", {"alpha": 5}, r"the neck lives for (\d\.\d)", r"lifetime (\d\.\d)"),
    ("07", "belief", {"shape": "50 points"}, r"50 points: significant in (\d+)", r"alone: reported in (\d+)"),
    ("07", "belief", {"shape": "50 points"}, r"50 points: .* reported in (\d+)", r"belief: reported in (\d+)"),
    ("07", "gates", {"beta": 0}, r"beta 0\.00 m: (\d+) names", r"(\d+) names in the film"),
    ("07", "gates", {"beta": 33}, r"beta 0\.05 m: (\d+) names", r"(\d+) names in the film"),
    ("07", "gates", {"beta": 80}, r"beta 0\.12 m: (\d+) names", r"(\d+) names in the film"),
    ("08", "repaint", {}, r"aaaaaabbbbbb\s+(\d\.\d\d)", r"MOTA (\d\.\d\d)"),
    ("08", "repaint", {}, r"aaaaaabbbbbb\s+\S+\s+(\d\.\d\d)", r"IDF1 (\d\.\d\d)"),
    ("08", "repaint", {"keys": "RRRRRRb" + "Ra" * 6}, r"aaaaabaaaaaa\s+\S+\s+(\d\.\d\d)", r"IDF1 (\d\.\d\d)"),
    ("08", "repaint", {"keys": "RRRRRRb" + "Ra" * 6}, r"aaaaabaaaaaa\s+\S+\s+\S+\s+(\d\.\d\d)", r"HOTA (\d\.\d\d)"),
    ("11", "leak", {"gap": 999}, r"by episode: error at t\+60 (\d+\.\d) cm", r"mean error (\d+\.\d) cm"),
    ("13", "turning", {"angle": 2}, r"30 degrees: PointNet is (\d+\.\d) cm", r"pointnet (\d+\.\d)$"),
    ("15", "treatments", {}, r"seqPH is (\d+\.\d) cm outside of the marked waist", r"seqPH (\d+\.\d) cm"),
    ("16", "planning", {}, r"guide at the start: (\d+) cm", r"guide (\d+) cm, not around"),
]


@pytest.mark.parametrize(("chapter", "name", "turns", "printed", "shown"), TURNED)
def test_a_turned_figure_states_what_the_library_printed(
    chromium: Any, chapter: str, name: str, turns: dict[str, Any], printed: str, shown: str
) -> None:
    page = next(page for page in CHAPTERS if page.startswith(f"notebooks/{chapter}"))
    with Visit(chromium, page) as visit:
        frame = next(frame for frame in visit.figures() if frame.query_selector(f"body.{name}"))
        for control, value in turns.items():
            if control == "keys":
                frame.query_selector("#scene").focus()
                for key in value:
                    frame.query_selector("#scene").press({"E": "Enter", "R": "ArrowRight"}.get(key, key))
            else:
                frame.query_selector(f"#{control}").evaluate(SET, value)
        frame.evaluate(SETTLED)
        there = re.search(printed, visit.page.inner_text("body"))
        here = re.search(shown, frame.query_selector("#status").inner_text())
        assert there is not None
        assert here is not None
        assert float(here[1]) == pytest.approx(float(there[1]), abs=0.006)  # printed with two digits
        assert visit.trouble == []


KERNEL = ["sampling.js", "rips.js", "assign.js", "seqph.js", "worker.js"]
IN_WORKER = """async () => {
  const points = Float64Array.from({ length: 1500 }, (_, k) => Math.sin(k * k)), worker = kernelWorker(), shares = [];
  const found = await worker.run("persistence", [points, 500, 3], (share) => shares.push(share));
  const film = [[points, points, points], 3];
  const stopped = worker.run("track", film, () => worker.stop()).catch((error) => error.message);
  const here = ripsKernel().persistence(points, 500, 3);
  return { same: JSON.stringify(found) === JSON.stringify(here), loops: found.births.length, shares,
    stopped: await stopped, wrong: await worker.run("track", [[new Float64Array(0)], 3]).catch((error) => error.message),
    sample: (await worker.run("farthestPoints", [points, 500, 3, 7])).ids.length };
}"""


def test_the_kernel_works_in_a_worker_from_a_plain_folder(chromium: Any, tmp_path: Path) -> None:
    scripts = [(ROOT / "notebooks/chapter_tools/figures" / name).read_text("utf-8") for name in KERNEL]
    page = tmp_path / "page.html"
    page.write_text(f'<meta charset="utf-8"><script>{"".join(scripts)}</script>', "utf-8")
    with Visit(chromium, str(page)) as visit:
        told = visit.ask(IN_WORKER)
        assert told["same"]
        assert told["loops"] > 50
        assert len(told["shares"]) > 10
        assert told["shares"] == sorted(told["shares"])
        assert told["stopped"] == "stopped"
        assert told["wrong"] == "frame 0 has no points"
        assert told["sample"] == 7
        assert visit.trouble == []


# Move a slider, but not to an end, where other controls may have nothing to show.
MOVE = """e => {
  const at = (share) => +e.min + share * (e.max - e.min);
  e.value = at(+e.value > at(0.5) ? 0.3 : 0.7);
  e.dispatchEvent(new Event("input"));
}"""


def _use(frame: Any, control: Any) -> None:
    """Use a control as a reader does."""
    kind = control.evaluate("e => e.type || e.tagName.toLowerCase()")
    if kind == "range":
        control.evaluate(MOVE)
    elif kind == "canvas":
        control.focus()
        for key in ("n", "ArrowLeft", "ArrowUp", "ArrowLeft"):
            control.press(key)
    elif kind.startswith("select"):
        last = control.evaluate(
            "e => e.options[e.selectedIndex === e.options.length - 1 ? 0 : e.options.length - 1].value"
        )
        control.select_option(last)
    else:
        control.click()
        if control.get_attribute("id") == "play":
            frame.page.wait_for_timeout(250)
            control.click()
    frame.evaluate(SETTLED)
