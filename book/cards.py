"""Cards of the chapters on the first page, and the line below a title with the times to read, to work through and to run.

The times to read and to work through come from `times`, the time to run is measured in the last run of the notebook, and the
chapters that a chapter builds on are read from its own first sentence.
"""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx import addnodes
from times import time_needed

from chapter_tools import quiz

ROOT = Path(__file__).resolve().parent.parent
APPENDIX_A = "book/modules"  # the only appendix without code
TOPICS = re.compile(r"^\| \w+ \[[^]]*\]\(\.\./(notebooks/\w+)\.ipynb\) \| (.*) \|$", re.MULTILINE)
BEFORE = re.compile(r"^\*\*Before:\*\* .*", re.MULTILINE)


class chapter_cards(nodes.General, nodes.Element):
    """The place of the cards of all chapters."""


class Chapters(Directive):
    """Show the chapters as cards, part by part, from the tables of contents of this page."""

    def run(self) -> list[nodes.Node]:
        return [chapter_cards()]


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("chapters", Chapters)
    app.add_config_value("chapters_repository", "", "html")
    app.connect("doctree-resolved", _cards)
    app.connect("doctree-resolved", _line)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def label(page: str) -> str | None:
    """Return the number of a chapter's page, the letter of an appendix, or None for other pages."""
    folder, _, name = page.rpartition("/")
    if page == APPENDIX_A:
        return "A"
    return quiz.label(name) if folder == "notebooks" else None


def is_chapter(page: str | None) -> bool:
    """Return whether a page is made from a notebook."""
    return page is not None and page != APPENDIX_A and label(page) is not None


def chapters(app: Any) -> dict[str, str]:
    """Return the pages of all chapters and appendices by their numbers and letters."""
    return {label(page): page for page in sorted(app.env.found_docs) if label(page) is not None}


def read(chapter: str) -> dict[str, Any]:
    """Return a chapter's notebook."""
    return json.loads((ROOT / f"{chapter}.ipynb").read_text(encoding="utf-8"))


def builds_on(notebook: dict[str, Any]) -> list[str]:
    """Return the chapters that a chapter asks for in its line "**Before:** ..."; "[3] to [5]" are three chapters."""
    line = BEFORE.search("".join(notebook["cells"][0]["source"]))[0]
    line = re.sub(r"; you need at least [^;]*", "", line)  # the minimum for readers who skip the others
    numbers = [number.removeprefix("0") for number in re.findall(r"\]\((\d+b?)_\w+\.ipynb\)", line)]
    if ") to [" in line:
        return [str(number) for number in range(int(numbers[0]), int(numbers[-1]) + 1)]
    return numbers


def time_to_run(seconds: float | None) -> str:
    """Return the time to run in words, or nothing when it is not known."""
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{5 * max(1, round(seconds / 5))} s"
    return f"{round(seconds / 60)} min"


def takes(app: Any, chapter: str) -> str:
    """Return how long a chapter takes to read, to work through and to run."""
    seconds = app.env.nb_metadata.get(chapter, {}).get("exec_data", {}).get("runtime")
    text = time_needed(read(chapter))
    if seconds is not None:
        text += f", {time_to_run(seconds)} to run"
    return text


def links_to(app: Any, page: str, numbers: list[str]) -> str:
    """Return links from a page to chapters, called by their numbers."""
    pages = chapters(app)
    links = []
    for number in numbers:
        chapter = pages[number]
        title = html.escape(app.env.titles[chapter].astext().partition(". ")[2], quote=True)
        address = app.builder.get_relative_uri(page, chapter)
        links.append(f'<a href="{address}" title="{title}">{number}</a>')
    if len(links) == 1:
        return f"chapter {links[0]}"
    return f"chapters {', '.join(links[:-1])} and {links[-1]}"


def _about(app: Any, page: str, chapter: str) -> str:
    before = builds_on(read(chapter))
    needs = f"builds on {links_to(app, page, before)}" if before else "needs no other chapter"
    return f"{takes(app, chapter)}; {needs}"


def elsewhere(repository: str, chapter: str) -> str:
    """Return links to a chapter on Binder and Colab, which copy the public repository; nothing without a repository."""
    if not repository:
        return ""
    name = repository.removeprefix("https://github.com/")
    addresses = {
        "Binder": f"https://mybinder.org/v2/gh/{name}/main?labpath={chapter}.ipynb",
        "Colab": f"https://colab.research.google.com/github/{name}/blob/main/{chapter}.ipynb",
    }
    links = [f', <a href="{address}">{place}</a>' for place, address in addresses.items()]
    return f'<span class="topokit-elsewhere">{"".join(links)}</span>'


def _line(app: Any, doctree: nodes.document, docname: str) -> None:
    """Add a line below a chapter's title: how long it takes, and where else it can be read."""
    title = next(doctree.findall(nodes.title), None)
    if is_chapter(docname) and title is not None and app.builder.format == "html":
        notebook = docname.rpartition("/")[2] + ".ipynb"
        words = (
            f'{takes(app, docname)} &middot; <a href="{notebook}" download>download the notebook</a>'
            f'{elsewhere(app.config.chapters_repository, docname)}, <a href="?slides">slides</a>'
        )
        line = nodes.raw("", f'<p class="topokit-takes">{words}</p>', format="html")
        title.parent.insert(title.parent.index(title) + 1, line)


def _cards(app: Any, doctree: nodes.document, docname: str) -> None:
    for place in list(doctree.findall(chapter_cards)):
        about = dict(TOPICS.findall((ROOT / "book" / "chapters.md").read_text(encoding="utf-8")))
        parts = []
        for toc in app.env.tocs[docname].findall(addnodes.toctree):
            cards = [_card(app, chapter, about) for _, chapter in toc["entries"] if is_chapter(chapter)]
            if cards:
                caption = f'<h3 class="topokit-part">{toc["caption"]}</h3>'
                parts.append(f'{caption}<ul class="topokit-cards">{"".join(cards)}</ul>')
        place.replace_self(nodes.raw("", "".join(parts), format="html"))


def _card(app: Any, chapter: str, about: dict[str, str]) -> str:
    number, _, title = app.env.titles[chapter].astext().partition(". ")
    root = app.config.root_doc
    link = app.builder.get_relative_uri(root, chapter)
    picture = f"../_static/thumbnails/{thumbnail(app, chapter).name}"
    return (
        f'<li><a href="{link}"><img src="{picture}" alt="" loading="lazy"><span>{number}</span>'
        f"<strong>{html.escape(title)}</strong></a><p>{html.escape(about.get(chapter, ''))}</p>"
        f'<p class="topokit-takes">{_about(app, root, chapter)}</p></li>'
    )


def thumbnail(app: Any, chapter: str) -> Path:
    """Return a chapter's picture for its card: a photograph-like one if there is one, else the largest light drawing."""
    images = {Path(app.srcdir) / image["uri"] for image in app.env.get_doctree(chapter).findall(nodes.image)}
    candidates = []
    for path in images:
        drawn_by_chapter = "jupyter_execute" in path.parts
        if drawn_by_chapter and (path.suffix == ".png" or path.stat().st_size < 250_000):
            candidates.append((path.suffix == ".png", path.stat().st_size, path.name, path))
    if not candidates:  # the chapter has not run
        return ROOT / "book" / "_static" / "apron.png"
    return max(candidates)[-1]
