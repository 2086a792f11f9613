"""Questions with answers on the page and for teachers, links to the slides, and the notebooks beside their pages."""

from __future__ import annotations

import html
import json
import re
import shutil
from pathlib import Path
from typing import Any

from cards import ROOT, chapters, is_chapter
from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.util.docutils import SphinxDirective

from chapter_tools import quiz

TOOLS = ROOT / "notebooks" / "chapter_tools"
LEVELS = {1: "one idea", 2: "two ideas", 3: "a surprise"}
ASKED = re.compile(r'ask\("([^"]+)", \.\.\.\)')


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("questions", Questions)
    app.add_directive("slides", Slides)
    app.connect("doctree-resolved", _answered_here)
    app.connect("build-finished", _notebooks_beside_their_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _answered_here(app: Any, doctree: nodes.document, docname: str) -> None:
    """Put a form for the guess where a notebook asks to write it into the cell; book.js gives the replies of `ask`."""
    if app.builder.format != "html":
        return
    for cell in doctree.findall(lambda node: "cell" in getattr(node, "attributes", {}).get("classes", ())):
        asked = ASKED.search(cell.astext())
        paragraphs = list(cell.findall(nodes.paragraph))  # none when the chapters were not run
        if asked and paragraphs:
            question = quiz.questions()[asked[1]]
            names = ("answer", "tolerance", "wrong", "why", "smaller", "larger")
            data = html.escape(json.dumps({name: getattr(question, name) for name in names}))
            form = f'<form class="topokit-question" data-question="{data}"><label>Your guess {_field(question)}</label>'
            form += "<button>check</button><output></output></form>"
            paragraphs[-1].replace_self(nodes.raw("", form, format="html"))


def _field(question: quiz.Question) -> str:
    if question.choices:
        options = "".join(f"<option>{key}</option>" for key in question.choices)
        return f'<select name="guess">{options}</select>'
    kind = "text" if isinstance(question.answer, str) else 'number" step="any'
    return f'<input name="guess" required autocomplete="off" type="{kind}">'


def for_teachers(name: str, question: quiz.Question) -> str:
    """Return a question as Markdown with its answer folded."""
    choices = "".join(f"- **{key}** {text}\n" for key, text in (question.choices or {}).items())
    within = f", within {question.tolerance:g}" if question.tolerance else ""
    remarks = [f"- *{each['guess']}*: {each['remark']}\n" for each in question.wrong]
    if not isinstance(question.answer, str):
        remarks += [f"- *too small*: {question.smaller}\n", f"- *too large*: {question.larger}\n"]
    return (
        f"**{name}** ({LEVELS[question.level]}). {question.question}\n\n{choices}\n"
        f"<details><summary>Answer to {name}, and the replies to wrong guesses</summary>\n\n"
        f"**{question.answer}**{within}. {question.why}\n\n{''.join(remarks)}\n"
        f"Computed by `{question.by}` after the cells {', '.join(f'`{cell}`' for cell in question.cells)}.\n\n</details>\n\n"
    )


class Questions(SphinxDirective):
    """Show all questions of the book with their answers, chapter by chapter."""

    def run(self) -> list[nodes.Node]:
        asked = quiz.questions()
        text = ""
        for chapter in dict.fromkeys(question.chapter for question in asked.values()):
            kind = "Chapter" if chapter.isdigit() else "Appendix"
            text += f"*{kind} {chapter}*\n\n"  # links.py makes it a link
            text += "".join(for_teachers(name, each) for name, each in asked.items() if each.chapter == chapter)
        for file in (TOOLS / "questions").glob("*.json"):
            self.env.note_dependency(str(file))
        self.env.note_dependency(str(TOOLS / "quiz.py"))
        place = nodes.Element()
        self.state.nested_parse(text.splitlines(), self.content_offset, place)
        return place.children


class Slides(Directive):
    """Show links to the slides of each chapter."""

    def run(self) -> list[nodes.Node]:
        pages = sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))
        links = [f'<a href="../notebooks/{page}.html?slides">{quiz.label(page)}</a>' for page in pages]
        return [nodes.raw("", f"<p>Slides of chapter {', '.join(links)}.</p>", format="html")]


def _notebooks_beside_their_pages(app: Any, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        for chapter in filter(is_chapter, chapters(app).values()):
            shutil.copy(ROOT / f"{chapter}.ipynb", Path(app.outdir) / f"{chapter}.ipynb")
