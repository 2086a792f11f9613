"""The book's shell: drawings that go into a page, results that go into the first one, chapters called by their numbers."""

from __future__ import annotations

import base64
import html
import importlib
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sphinx", reason="the book's extension needs Sphinx: pip install 'topokit[book]'")
ROOT = Path(__file__).resolve().parent.parent
NUMBER = re.compile(r"\b[Cc]hapters?\s+(\d+)")
LINK = re.compile(r"\[([^][]*)\]\([^()]*?(\d+)_\w+\.ipynb[^()]*\)")


@pytest.fixture(scope="module")
def book():
    """The extensions in the folder book, by their names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "book")
        yield importlib.import_module


@pytest.fixture(scope="module")
def shell(book):
    return book("shell")


def prose() -> dict[str, str]:
    """The pages that people wrote, notebooks by their text cells, code left out."""
    pages = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "book/index.md")}
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        pages[path.name] = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return {name: re.sub(r"`[^`]*`", "", text) for name, text in pages.items()}


@pytest.mark.parametrize("page", prose())
def test_links_to_chapters_say_the_number_of_their_file(page):
    links = [(text, int(number)) for text, number in LINK.findall(prose()[page])]
    said = [(int(found[1]), number) for text, number in links if (found := NUMBER.search(text))]
    assert [pair for pair in said if pair[0] != pair[1]] == []


def test_a_chapter_links_to_the_public_repository_on_binder_and_colab_if_there_is_one(book):
    links = book("cards").elsewhere
    assert links("", "notebooks/03_seeing") == ""
    public = re.search(r'^chapters_repository = "(.*)"', (ROOT / "book" / "conf.py").read_text("utf-8"), re.MULTILINE)[
        1
    ]
    assert f'Repository = "{public}"' in (ROOT / "pyproject.toml").read_text("utf-8")
    addresses = re.findall(r'href="([^"]*)"', links("https://github.com/one/two", "notebooks/03_seeing"))
    assert addresses == [
        "https://mybinder.org/v2/gh/one/two/main?labpath=notebooks/03_seeing.ipynb",
        "https://colab.research.google.com/github/one/two/blob/main/notebooks/03_seeing.ipynb",
    ]


@pytest.mark.parametrize("page", ["README.md", "book/index.md"])
def test_every_chapter_that_is_named_by_its_number_is_a_link(page):
    bare = LINK.sub("", prose()[page])
    assert [bare[max(0, m.start() - 30) : m.end() + 30] for m in NUMBER.finditer(bare)] == []


def test_chapters_are_numbered_from_zero_without_a_gap_and_in_the_order_of_the_first_page():
    files = sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))
    assert [int(name[:2]) for name in files] == list(range(len(files)))
    assert (
        re.findall(r"^/notebooks/(\w+)$", (ROOT / "book/index.md").read_text(encoding="utf-8"), re.MULTILINE) == files
    )


def test_readme_says_what_every_chapter_is_about(book):
    about = dict(book("cards").TOPICS.findall((ROOT / "README.md").read_text(encoding="utf-8")))
    assert sorted(about) == sorted(f"notebooks/{path.stem}" for path in (ROOT / "notebooks").glob("*.ipynb"))
    assert all(about.values())


def test_a_drawing_takes_the_colours_of_the_page(shell, tmp_path):
    plt = pytest.importorskip("matplotlib.pyplot")
    figure, axes = plt.subplots()
    axes.plot([0, 1], [0, 1], color="0.5")
    axes.plot([0, 1], [1, 0], color="#d55e00")
    axes.set(xlabel="birth & more", title="a plot")
    with plt.rc_context({"svg.fonttype": "none"}):
        file = tmp_path / "drawing.svg"
        figure.savefig(file)
    plt.close(figure)
    svg = file.read_text(encoding="utf-8")
    drawn = shell._in_page(svg, "")
    assert not {"#000000", "#ffffff"} & set(re.findall("#[0-9a-f]{6}", drawn))  # neither ink nor ground of its own
    assert "color-mix(in srgb, var(--ink), var(--ground) 50%)" in drawn
    assert "#d55e00" in drawn
    label = html.unescape(re.search('aria-label="(Plot: [^"]*)"', drawn)[1])
    assert set(label.removeprefix("Plot: ").split("; ")) == {"birth & more", "a plot"}
    assert 'aria-label="two &quot;lines&quot;"' in shell._in_page(svg, 'two "lines"')
    names = re.findall(r'\bid="([^"]*)"', drawn)
    assert names
    assert not set(names) & set(re.findall(r'\bid="([^"]*)"', svg))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]*)', drawn)) <= set(names)


def test_a_drawing_weighs_less_and_looks_the_same(shell, tmp_path):
    plt = pytest.importorskip("matplotlib.pyplot")
    Image = pytest.importorskip("PIL.Image")
    figure, axes = plt.subplots()
    angle = np.linspace(0, 6, 400)
    axes.plot(np.cos(angle), np.sin(angle))
    axes.scatter(np.cos(angle), np.sin(2 * angle), c=angle, rasterized=True)
    figure.savefig(tmp_path / "drawing.svg")
    plt.close(figure)
    svg = (tmp_path / "drawing.svg").read_text(encoding="utf-8")
    drawn = shell._in_page(svg, "")
    assert len(drawn) < 0.6 * len(svg)
    before, after = (Image.open(io.BytesIO(base64.b64decode(shell._PIXELS.search(text)[0]))) for text in (svg, drawn))
    assert before.size == after.size
    difference = np.asarray(before.convert("RGBA"), int) - np.asarray(after.convert("RGBA"), int)
    assert np.abs(difference).mean() < 2
    assert shell._NUMBER.sub(shell._hundredths, "M -1.239999 20.000001") == "M -1.24 20"


def test_a_result_is_found_by_its_path_and_a_star_is_a_sum(shell):
    results = {"rows": [{"hung": 3}, {"hung": 4}]}
    assert shell._at(results, ["rows", "1", "hung"]) == 4
    assert shell._at(results, ["rows", "*", "hung"]) == 7
    with pytest.raises(KeyError):
        shell._at(results, ["row"])


def test_chapters_build_on_earlier_ones(book):
    cards, on = book("cards"), {}
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        on[int(path.name[:2])] = cards.builds_on(cards.read(f"notebooks/{path.stem}"))
    assert all(before < chapter for chapter, asked in on.items() for before in asked)
    assert not on[0]
    assert all(asked for chapter, asked in on.items() if chapter > 1)
    words = "**Before:** [chapters 2](02_a.ipynb) to [4](04_b.ipynb); [chapter 0](00_c.ipynb) at least."
    assert cards.builds_on({"cells": [{"source": ["# A\n", "\n", words]}]}) == [2, 3, 4]


def test_first_sentences_call_chapters_by_the_numbers_of_their_files():
    for name, text in prose().items():
        for said in re.findall(r"^\*\*Before:\*\* .*", text, re.MULTILINE):
            called = re.findall(r"\[(?:chapters? )?(\d+)\]\((\d+)_", said)
            assert all(int(number) == int(file) for number, file in called), name


def test_time_to_read_is_of_words_and_of_code_that_is_shown(book):
    words = {"cell_type": "markdown", "source": ["word " * 1500], "metadata": {}}
    shown = {"cell_type": "code", "source": ["1"], "metadata": {}}
    folded = shown | {"metadata": {"tags": ["hide-input"]}}
    minutes = book("cards").minutes_to_read
    assert minutes({"cells": [words]}) == 5 * round(1500 / book("cards").WORDS / 5)
    assert minutes({"cells": [words] + [shown] * 20}) == minutes({"cells": [words] + [folded] * 20}) + 10
    assert minutes({"cells": []}) == 5
    assert [book("cards").time_to_run(s) for s in (None, 1, 41, 130)] == ["", "5 s", "40 s", "2 min"]


def test_chapters_called_by_their_numbers_are_found(book):
    pieces = book("links").pieces
    assert pieces("as in chapter 3.") == [("as in ", None), ("chapter 3", 3), (".", None)]
    said = "Chapters 3 to 6 say, and chapters 1, 2 and 14"
    assert "".join(text for text, _ in pieces(said)) == said
    assert [(text, k) for text, k in pieces(said) if k is not None] == [(str(k), k) for k in (3, 6, 1, 2, 14)]
    assert pieces("the chapter after 3") == [("the chapter after 3", None)]
    names = book("links").names
    assert names("definition", " (Bar, killer edge, and diagram)") == ["bar", "killer edge", "diagram"]
    assert names("theorem", " (Lune theorem)") == ["Lune theorem"]
    assert names("lemma", "") == []


def test_teachers_see_every_question_with_its_answer_folded(book):
    from chapter_tools.quiz import questions

    for name, question in questions().items():
        told = book("teach").told(name, question)
        before, _, folded = told.partition("<details>")
        assert question.question in before
        assert all(text in before for text in (question.choices or {}).values())
        assert f"**{question.answer}**" in folded
        assert all(each["remark"] in folded for each in question.wrong)


def test_files_for_other_places_name_what_is_there():
    container = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert container["image"].endswith(":3.11")
    assert container["postCreateCommand"] == "make env"
    packages = (ROOT / ".binder" / "apt.txt").read_text(encoding="utf-8").split()
    assert all(package in container["onCreateCommand"] for package in packages)
    assert all(package in (ROOT / "README.md").read_text(encoding="utf-8") for package in packages)
    assert (ROOT / ".binder" / "runtime.txt").read_text(encoding="utf-8").strip() == "python-3.11"
    assert "-r ../requirements.txt" in (ROOT / ".binder" / "requirements.txt").read_text(encoding="utf-8").splitlines()
    linked = re.findall(r"lab/tree/(\S+)", (ROOT / "book" / "elsewhere.md").read_text(encoding="utf-8"))
    assert linked
    assert all((ROOT / path).is_file() for path in linked)


def test_a_page_for_paper_leads_its_links_to_itself(book, tmp_path):
    paper = book("on_paper")
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
    page = paper.whole(tmp_path)
    for part in ('href="#p0-a"', 'id="p1-b"', 'src="html/_images/c.png"', 'xlink:href="#p1-q"', "url(#p1-q)"):
        assert part in page
    assert page.count('href="#p0-a"') == 2
    assert 'href="html/_static/a.css"' in page
    assert 'href="https://x.org/#y"' in page
    assert "lazy" not in page
