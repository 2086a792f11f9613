"""Test the book's extension of Sphinx: numbers of chapters, links, cards, drawings, results, questions, the page for paper."""

from __future__ import annotations

import html
import importlib
import json
import re
from pathlib import Path

import pytest

from chapter_tools.quiz import label, questions

pytest.importorskip("sphinx", reason="the book's extension needs Sphinx: pip install 'topokit[book]'")
ROOT = Path(__file__).resolve().parent.parent
CHAPTERS = sorted((ROOT / "notebooks").glob("*.ipynb"))
NUMBER = re.compile(r"\b[Cc]hapters?\s+(\d+)")
LINK = re.compile(r"\[([^][]*)\]\([^()]*?(\d+)_\w+\.ipynb[^()]*\)")


@pytest.fixture(scope="module")
def book():
    """Import a script of the folder book by its name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "book")
        yield importlib.import_module


def prose() -> dict[str, str]:
    """Return the text of README, the first page and the chapters without code."""
    pages = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "book/index.md")}
    for path in CHAPTERS:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        pages[path.name] = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return {name: re.sub(r"`[^`]*`", "", text) for name, text in pages.items()}


# ---- chapters and their numbers


def test_links_to_chapters_name_the_number_of_their_file():
    for page, text in prose().items():
        for words, number in LINK.findall(text):
            named = NUMBER.search(words)
            assert not named or int(named[1]) == int(number), f"{page}: {words}"


@pytest.mark.parametrize("page", ["README.md", "book/index.md"])
def test_every_chapter_called_by_its_number_is_a_link(page):
    assert not NUMBER.findall(LINK.sub("", prose()[page]))


def test_chapters_are_numbered_without_a_gap_and_listed_in_order(book):
    names = [path.stem for path in CHAPTERS]
    labels = [label(name) for name in names]
    numbers = [int(name) for name in labels if name.isdigit()]
    letters = ["A", *(name for name in labels if not name.isdigit())]  # appendix A is a page of prose
    assert numbers == list(range(len(numbers)))
    assert letters == list("ABCDEFGH"[: len(letters)])
    assert (
        re.findall(r"^/notebooks/(\w+)$", (ROOT / "book/index.md").read_text(encoding="utf-8"), re.MULTILINE) == names
    )
    topics = dict(book("cards").TOPICS.findall((ROOT / "book" / "chapters.md").read_text(encoding="utf-8")))
    assert sorted(topics) == [f"notebooks/{name}" for name in names]


def test_chapters_build_on_earlier_ones(book):
    cards = book("cards")
    for path in CHAPTERS:
        chapter = label(path.name)
        before = cards.builds_on(cards.read(f"notebooks/{path.stem}"))
        assert not chapter.isdigit() or all(number < int(chapter) for number in before)
        assert before or chapter in ("0", "1")
    words = "**Before:** [chapters 2](02_a.ipynb) to [4](04_b.ipynb); you need at least [chapter 0](00_c.ipynb)."
    assert cards.builds_on({"cells": [{"source": ["# A\n", "\n", words]}]}) == [2, 3, 4]


def test_an_old_address_leads_to_a_chapter(book):
    moved = book("moved")
    names = {path.stem for path in CHAPTERS}
    assert set(moved.MOVED.values()) <= names
    assert not set(moved.MOVED) & names
    page = moved.page_that_leads_to("07_new.html")
    assert 'content="1; url=07_new.html"' in page
    assert 'href="07_new.html"' in page
    assert 'location.replace("07_new.html" + location.search + location.hash)' in page


def test_chapters_called_by_their_numbers_are_found(book):
    links = book("links")
    text = "Chapters 3 to 6 show, and chapters 1, 2 and 14"
    pieces = links.pieces(text)
    assert "".join(piece for piece, _ in pieces) == text
    assert [(piece, chapter) for piece, chapter in pieces if chapter] == [(k, k) for k in ("3", "6", "1", "2", "14")]
    assert links.pieces("as in chapter 3.") == [("as in ", None), ("chapter 3", "3"), (".", None)]
    assert links.pieces("Appendix B shows") == [("Appendix B", "B"), (" shows", None)]
    assert links.names("definition", " (Bar, killer edge, and diagram)") == ["bar", "killer edge", "diagram"]
    assert links.names("theorem", " (Lune theorem)") == ["Lune theorem"]


# ---- drawings


def test_a_drawing_has_the_colours_of_the_page_and_ids_of_its_own(book, tmp_path):
    plt = pytest.importorskip("matplotlib.pyplot")
    figure, axes = plt.subplots()
    axes.plot([0, 1], [0, 1], color="0.5")
    axes.plot([0, 1], [1, 0], color="#d55e00")
    axes.set(xlabel="birth & more", title="a plot")
    with plt.rc_context({"svg.fonttype": "none"}):
        figure.savefig(tmp_path / "drawing.svg")
    plt.close(figure)
    svg = (tmp_path / "drawing.svg").read_text(encoding="utf-8")
    drawn = book("shell")._in_page(svg, "")
    assert not {"#000000", "#ffffff"} & set(re.findall("#[0-9a-f]{6}", drawn))
    assert "color-mix(in srgb, var(--ink), var(--ground) 50%)" in drawn
    assert "#d55e00" in drawn
    label = html.unescape(re.search('aria-label="(Plot: [^"]*)"', drawn)[1])
    assert set(label.removeprefix("Plot: ").split("; ")) == {"birth & more", "a plot"}
    ids = set(re.findall(r'\bid="([^"]*)"', drawn))
    assert ids
    assert not ids & set(re.findall(r'\bid="([^"]*)"', svg))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]*)', drawn)) <= ids


# ---- results, questions, paper


def test_a_result_is_found_by_its_path_and_a_star_is_a_sum(book):
    results = {"rows": [{"hung": 3}, {"hung": 4}]}
    assert book("shell")._at(results, ["rows", "1", "hung"]) == 4
    assert book("shell")._at(results, ["rows", "*", "hung"]) == 7
    with pytest.raises(KeyError):
        book("shell")._at(results, ["row"])


def test_teachers_see_every_question_with_its_answer_folded(book):
    for name, question in questions().items():
        visible, _, folded = book("teach").for_teachers(name, question).partition("<details>")
        assert question.question in visible
        assert all(text in visible for text in (question.choices or {}).values())
        assert f"**{question.answer}**" in folded
        assert all(typical["remark"] in folded for typical in question.wrong)


def test_the_links_of_the_page_for_paper_stay_inside(book, tmp_path):
    nav = '<li class="toctree-l1"><a class="reference internal" href="../notebooks/00.html">0</a></li>'
    pages = {
        "book/index.html": f'<head><title>x</title></head>{nav}<article class="bd-article"><a href="#a">a</a></article>',
        "notebooks/00.html": '<head><title>x</title><link href="../_static/a.css"></head><article class="bd-article">'
        '<p id="b" class="math">b</p><a href="../book/index.html#a">a</a><img src="../_images/c.png" loading="lazy">'
        '<svg><path id="q"/><use xlink:href="#q"/><g clip-path="url(#q)"/></svg><a href="https://x.org/#y">x</a></article>',
    }
    for name, text in pages.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    page = book("on_paper").whole(tmp_path)
    for part in ('id="p1-b"', 'src="html/_images/c.png"', 'xlink:href="#p1-q"', "url(#p1-q)", "html/_static/a.css"):
        assert part in page
    assert page.count('href="#p0-a"') == 2
    assert 'href="https://x.org/#y"' in page
    assert "lazy" not in page
