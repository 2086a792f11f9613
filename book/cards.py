"""What a chapter takes: its card on the first page, and the line at its top. Numbers are counted or measured, not typed.

Time to read comes from words and from code that is shown, time to run from the last run of the notebook, what a chapter builds on
from its own first sentence.
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

ROOT = Path(__file__).resolve().parent.parent
CHAPTER = re.compile(r"notebooks/0*(\d+)_")
TOPICS = re.compile(r"^\| \d+ \[[^]]*\]\((notebooks/\w+)\.ipynb\) \| (.*) \|$", re.MULTILINE)
WORDS, CELL = 200, 0.5  # words that are read in a minute; minutes for a cell of code that is shown

BEFORE = re.compile(r"^\*\*Before:\*\* .*", re.MULTILINE)


class chapter_cards(nodes.General, nodes.Element):
    """Where the cards of all chapters go."""


class Chapters(Directive):
    """The chapters as cards, part by part, from the tables of contents of this page."""

    def run(self) -> list[nodes.Node]:
        return [chapter_cards()]


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("chapters", Chapters)
    app.add_config_value("chapters_repository", "", "html")
    app.connect("doctree-resolved", _cards)
    app.connect("doctree-resolved", _line)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def chapters(app: Any) -> dict[int, str]:
    """The pages of all chapters by their numbers."""
    return {int(found[1]): name for name in sorted(app.env.found_docs) if (found := CHAPTER.match(name))}


def read(chapter: str) -> dict[str, Any]:
    """A chapter's notebook."""
    return json.loads((ROOT / f"{chapter}.ipynb").read_text(encoding="utf-8"))


def builds_on(notebook: dict[str, Any]) -> list[int]:
    """The chapters that a chapter asks for where it says "**Before:** ..."; "[...] to [...]" are all between, too."""
    said = BEFORE.search("".join(notebook["cells"][0]["source"]))[0]
    said = re.sub(r"; [^;]* at least", "", said)  # that is for who skips these
    numbers = [int(number) for number in re.findall(r"\]\((\d+)_\w+\.ipynb\)", said)]
    return list(range(numbers[0], numbers[-1] + 1)) if ") to [" in said else numbers


def minutes_to_read(notebook: dict[str, Any]) -> int:
    """From the words and the code that is not folded, to five minutes."""
    words = code = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            words += len("".join(cell["source"]).split())
        else:
            code += not {"hide-input", "hide-cell", "remove-input"} & set(cell["metadata"].get("tags", ()))
    return max(5, 5 * round((words / WORDS + CELL * code) / 5))


def time_to_run(seconds: float | None) -> str:
    """In words; what is not known is left out."""
    if seconds is None:
        return ""
    return f"{5 * max(1, round(seconds / 5))} s" if seconds < 90 else f"{round(seconds / 60)} min"


def takes(app: Any, chapter: str) -> str:
    """How long a chapter takes."""
    ran = app.env.nb_metadata.get(chapter, {}).get("exec_data", {}).get("runtime")
    run = time_to_run(ran)
    return f"{minutes_to_read(read(chapter))} min to read" + (f", {run} to run" if run else "")


def links_to(app: Any, page: str, numbers: list[int]) -> str:
    """Links from a page to chapters, called by their numbers."""
    pages = chapters(app)
    titles = {k: app.env.titles[pages[k]].astext().partition(". ")[2] for k in numbers}
    at = {k: app.builder.get_relative_uri(page, pages[k]) for k in numbers}
    links = [f'<a href="{at[k]}" title="{html.escape(titles[k], quote=True)}">{k}</a>' for k in numbers]
    if len(links) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"chapters {links[0]} to {links[-1]}"
    return ("chapters " if len(links) > 1 else "chapter ") + " and ".join(", ".join(links).rsplit(", ", 1))


def _about(app: Any, page: str, chapter: str) -> str:
    before = builds_on(read(chapter))
    return f"{takes(app, chapter)}; " + (
        f"builds on {links_to(app, page, before)}" if before else "needs no other chapter"
    )


def elsewhere(repository: str, chapter: str) -> str:
    """Links to a chapter on machines that copy the public repository, "https://github.com/OWNER/NAME"; none if it is empty."""
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
    """Say below a chapter's title how long it takes; its first sentence says what it builds on."""
    title = next(doctree.findall(nodes.title), None)
    if CHAPTER.match(docname) and title is not None and app.builder.format == "html":
        notebook = docname.rpartition("/")[2] + ".ipynb"
        words = (
            f'{takes(app, docname)} &middot; <a href="{notebook}" download>download the notebook</a>'
            f'{elsewhere(app.config.chapters_repository, docname)}, <a href="?slides">slides</a>'
        )
        line = nodes.raw("", f'<p class="topokit-takes">{words}</p>', format="html")
        title.parent.insert(title.parent.index(title) + 1, line)


def _cards(app: Any, doctree: nodes.document, docname: str) -> None:
    for place in list(doctree.findall(chapter_cards)):
        about = dict(TOPICS.findall((ROOT / "README.md").read_text(encoding="utf-8")))
        parts = []
        for toc in app.env.tocs[docname].findall(addnodes.toctree):
            cards = [_card(app, chapter, about) for _, chapter in toc["entries"] if CHAPTER.match(chapter or "")]
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
    """Of the pictures that a chapter draws a photograph-like one, else the richest drawing that is not heavy."""
    images = {Path(app.srcdir) / image["uri"] for image in app.env.get_doctree(chapter).findall(nodes.image)}
    drawn = [
        path
        for path in images
        if "jupyter_execute" in path.parts and (path.suffix == ".png" or path.stat().st_size < 250_000)
    ]
    nothing = ROOT / "book" / "_static" / "apron.png"  # of a chapter that has not run
    return max(drawn, key=lambda path: (path.suffix == ".png", path.stat().st_size, path.name), default=nothing)
