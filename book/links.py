"""Links from page to page: chapters and appendices called by their numbers and letters become links, and terms enter the index.

Links, code and headings are left alone. The index lists definitions and theorems of the chapters by their titles, and for each
term of the glossary the first place in each chapter that uses it.
"""

from __future__ import annotations

import re
from typing import Any

from cards import chapters, label
from docutils import nodes
from sphinx import addnodes
from sphinx.transforms import SphinxTransform

# "chapter 3", "chapters 3 to 6", "chapters 5, 10 and 12", "appendix B"
CALLED = re.compile(r"\b(?:[Cc]hapters?\s+\d+(?:(?:,| to| and| or)\s+\d+)*|[Aa]ppendix\s+[A-Z]\b)")
STATED = ("definition", "theorem", "lemma", "proposition", "corollary")
KEPT = (nodes.reference, nodes.literal, nodes.literal_block, nodes.title, nodes.raw, nodes.math, nodes.caption)


def setup(app: Any) -> dict[str, bool]:
    app.connect("doctree-resolved", _link)
    app.add_transform(Index)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def pieces(text: str) -> list[tuple[str, str | None]]:
    """Split a text into pieces, each with the chapter it links to or None; a single chapter is linked with its word."""
    found = []
    at = 0
    for called in CALLED.finditer(text):
        numbers = list(re.finditer(r"\d+|\b[A-Z]$", called[0]))
        for number in numbers:
            start = called.start()
            if len(numbers) > 1:
                start += number.start()
            end = called.start() + number.end()
            found += [(text[at:start], None), (text[start:end], number[0])]
            at = end
    return [piece for piece in (*found, (text[at:], None)) if piece[0]]


def _link(app: Any, doctree: nodes.document, docname: str) -> None:
    if app.builder.format != "html":
        return
    pages = chapters(app)
    own = label(docname)
    for text in list(doctree.findall(nodes.Text)):
        if CALLED.search(text) and not _within(text, KEPT):
            text.parent.replace(text, [_piece(app, docname, own, pages, *piece) for piece in pieces(str(text))])


def _piece(app: Any, docname: str, own: Any, pages: dict[str, str], text: str, chapter: str | None) -> nodes.Node:
    if chapter not in pages or chapter == own:
        return nodes.Text(text)
    uri = app.builder.get_relative_uri(docname, pages[chapter])
    return nodes.reference(text, text, internal=True, refuri=uri, reftitle=app.env.titles[pages[chapter]].astext())


def _within(node: nodes.Node, kinds: tuple[type, ...]) -> bool:
    ancestor = node.parent
    while ancestor is not None:
        if isinstance(ancestor, kinds):
            return True
        ancestor = ancestor.parent
    return False


class Index(SphinxTransform):
    """Enter definitions, theorems and first uses of terms into the index."""

    default_priority = 800  # before the domains collect a page's entries, at 850

    def apply(self, **kwargs: Any) -> None:
        if label(self.env.docname) is None:
            return
        for stated in [node for node in self.document.findall(nodes.Element) if node.get("realtype") in STATED]:
            kind = stated["realtype"]
            for name in names(kind, stated.get("title", "")):
                _enter(stated, name, stated["ids"][0], "" if name.endswith(kind) else kind)
        seen = set()
        for used in list(self.document.findall(addnodes.pending_xref)):
            if used.get("reftype") == "term" and used["reftarget"].casefold() not in seen:
                seen.add(used["reftarget"].casefold())
                place = f"term-used-{nodes.make_id(used['reftarget'])}"
                used.parent.insert(used.parent.index(used), nodes.target("", "", ids=[place]))
                _enter(used, used["reftarget"], place, "")


def names(kind: str, title: str) -> list[str]:
    """Return the names in a title: the definition "(Bar, killer edge, diagram)" has three, a theorem one."""
    title = title.strip(" ()")
    if not title:
        return []
    if kind != "definition":
        return [title]
    terms = [term.strip().removeprefix("and ") for term in title.split(",")]
    return [term[0].lower() + term[1:] for term in terms if term]


def _enter(node: nodes.Node, name: str, place: str, kind: str) -> None:
    entry = addnodes.index(entries=[("single", f"{name} ({kind})" if kind else name, place, "", None)])
    node.parent.insert(node.parent.index(node), entry)
