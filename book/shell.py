"""An extension of Sphinx: numbers of chapters and figures, drawings in the colours of the page, results, an offline search.

Chapter numbers come from the names of files, the topics of chapters from the table in book/chapters.md, and results on the first
page from book/results. A figure, drawn or live, has its caption in its cell's metadata, `mystnb.figure.caption`.
"""

from __future__ import annotations

import base64
import html
import io
import json
import re
import shutil
import uuid
from pathlib import Path
from typing import Any

import tomllib
from cards import TOPICS, is_chapter, label, thumbnail
from docutils import nodes
from docutils.parsers.rst import Directive
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
DESCRIPTION = "Find the loops of cloth in a cloud of points, say where they are, and follow them through time."


def setup(app: Any) -> dict[str, bool]:
    app.add_directive("film", Film)
    app.add_directive("hold", Hold)
    app.connect("source-read", _figures_of_the_first_page)
    app.connect("doctree-read", _number, priority=400)  # before titles are collected, at 500
    app.connect("doctree-read", _tidy, priority=400)
    app.connect("env-get-updated", _number_figures, priority=900)  # after Sphinx, which counts them through the book
    app.connect("doctree-resolved", _drawings)
    app.connect("html-page-context", _head)
    app.connect("build-finished", _finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


# ---- numbers -----------------------------------------------------------------------------------------------------


def _number(app: Any, doctree: nodes.document) -> None:
    """Put the number of a chapter, or the letter of an appendix, before its title: on the page, in the sidebar, in the tab."""
    number = label(app.env.docname)
    title = next(doctree.findall(nodes.title), None)
    if number is not None and title is not None:
        title.insert(0, nodes.Text(f"{number}. "))


def _number_figures(app: Any, env: Any) -> list[str]:
    """Count the figures of each chapter anew: the third figure of chapter 2 is 2.3, here and in the copies for JupyterLab."""
    for page, kinds in env.toc_fignumbers.items():
        number = label(page)
        if number is not None:
            for k, place in enumerate(kinds.get("figure", {}), start=1):
                kinds["figure"][place] = (number, k)
    return []


_NOTHING = re.compile(r"\[?<(Axes|matplotlib|Figure)[^>]*>")  # the text of a plotting call's return value
_COLUMNS = re.compile(r"\S {2,}\S.*\S {2,}\S")  # of a line of a printed table


def _tidy(app: Any, doctree: nodes.document) -> None:
    """Remove outputs without content, mark printed tables, and fold the long tables on the page of results."""
    for block in list(doctree.findall(nodes.literal_block)):
        if "text_plain" in block["classes"] and _NOTHING.match(block.astext()):
            block.parent.remove(block)
        elif "stream" in block["classes"] and len(_COLUMNS.findall(block.astext())) > 1:
            block["classes"].append("columns")
    if app.env.docname.endswith("report/tables"):
        for head in doctree.findall(nodes.thead):
            head[0][0] += nodes.paragraph("", "model")
        for condition in filter(_is_section, doctree[0].children):
            for table in list(filter(_is_section, condition.children))[1:]:
                title, *content = table.children
                summary = f"<details><summary>{html.escape(title.astext())}</summary>"
                table.replace_self(
                    [nodes.raw("", summary, format="html"), *content, nodes.raw("", "</details>", format="html")]
                )


def _is_section(node: nodes.Node) -> bool:
    return isinstance(node, nodes.section)


# ---- pictures ----------------------------------------------------------------------------------------------------

_GREY = re.compile(r"#([0-9a-f]{2})\1\1\b")
_INK = "#1c2733"  # of true loops, topokit.view's INK
_LABEL = re.compile(r"<text[^>]*>(.*?)</text>", re.DOTALL)


def _drawings(app: Any, doctree: nodes.document, docname: str) -> None:
    """Put Matplotlib's SVG into the page itself, where its greys follow the theme and its text is the page's."""
    if app.builder.format != "html":
        return
    for image in list(doctree.findall(nodes.image)):
        path = Path(app.srcdir) / image["uri"]
        if path.suffix == ".svg" and "jupyter_execute" in path.parts:
            drawing = _in_page(path.read_text(encoding="utf-8"), image.get("alt", ""))
            image.replace_self(nodes.raw("", drawing, format="html"))


def _in_page(svg: str, description: str) -> str:
    """Return an SVG of Matplotlib for a page: unique ids, its own size, no background, greys between ink and ground."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)

    # The background of figure and axes is the first shape of each.
    svg = re.sub(r'(<g id="patch_1">\s*<path [^>]*style="fill: )#[0-9a-f]{6}', r"\1none", svg)
    svg = re.sub(r'(<g id="axes_\d+">\s*<g id="patch_\d+">\s*<path [^>]*style="fill: )#ffffff', r"\1none", svg)

    # Several drawings share a page, so each gets ids of its own.
    own = uuid.uuid5(uuid.NAMESPACE_OID, svg).hex[:8]
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{own}-", svg)

    # Lines without a colour of their own, and text, are black.
    svg = svg.replace(_INK, "var(--ink)")
    svg = _GREY.sub(lambda m: _between(int(m[1], 16)), svg)

    # Fewer bytes: coordinates in hundredths, pixels with a table of colours.
    width = float(re.search(r'width="([\d.]+)pt"', svg)[1]) * 4 / 3
    svg = re.sub(
        r'<svg [^>]*?viewBox="([^"]*)"[^>]*>', rf'<svg viewBox="\1" width="{width:.0f}" role="img">', svg, count=1
    )
    svg = _PIXELS.sub(_lighter, svg)
    svg = _PLACES.sub(lambda m: _NUMBER.sub(_hundredths, " ".join(m[0].split())), svg)

    label = html.escape(description or _labels(svg) or "Drawing", quote=True)
    svg = svg.replace('role="img"', f'role="img" aria-label="{label}"', 1)
    least = min(round(width), 560)
    return f'<div class="topokit-plot" tabindex="0" role="group" aria-label="figure" style="--least: {least}px">{svg}</div>'


_PIXELS = re.compile(r"(?<=data:image/png;base64,)[A-Za-z0-9+/=\s]+")
_PLACES = re.compile(r'\b[dxy]="[^"]*"')
_NUMBER = re.compile(r"-?\d+\.\d+")


def _hundredths(number: re.Match[str]) -> str:
    """Return a coordinate to a hundredth of a point, which is invisible; Matplotlib writes millionths."""
    return f"{float(number[0]):.2f}".rstrip("0").rstrip(".")


def _lighter(image: re.Match[str]) -> str:
    """Return the pixels in a drawing with a table of 256 colours where that is smaller; this halves the size of a page."""
    raw = base64.b64decode(image[0])
    out = io.BytesIO()
    with Image.open(io.BytesIO(raw)) as whole:
        table = whole.convert("RGBA").quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    table.save(out, "PNG", optimize=True)
    return base64.b64encode(min(raw, out.getvalue(), key=len)).decode()


def _between(level: int) -> str:
    """Return the grey of a level, from the page's ink at 0 to its ground at 255."""
    if level == 0:
        return "var(--ink)"
    if level == 255:
        return "var(--ground)"
    return f"color-mix(in srgb, var(--ink), var(--ground) {round(level / 2.55)}%)"


def _labels(svg: str) -> str:
    """Return the words in a drawing as its description, for a drawing whose author gave none."""
    texts = [html.unescape(re.sub(r"<[^>]*>", "", text)).strip() for text in _LABEL.findall(svg)]
    words = dict.fromkeys(text for text in texts if re.search(r"[^\W\d_]{2}", text))
    if not words:
        return ""
    return "Plot: " + "; ".join(words)[:300]


# ---- the first page ----------------------------------------------------------------------------------------------


class Film(Directive):
    """Show a recorded hanging that plays and can be turned."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        from topokit import track
        from topokit.io import load_episode
        from topokit.view import player

        path = self.arguments[0]
        self.state.document.settings.env.note_dependency(str(ROOT / path))
        episode = load_episode(ROOT / path)
        film = player(episode, track(episode.observed), height=460, start=0, film=True)
        return [nodes.raw("", f'<div class="topokit-film">{film._repr_html_()}</div>', format="html")]


class Hold(Directive):
    """Show the apron of a recorded hanging, which the reader hangs with two hands."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        from chapter_tools.figures import hold
        from topokit.io import load_episode

        path = self.arguments[0]
        self.state.document.settings.env.note_dependency(str(ROOT / path))
        figure = hold(load_episode(ROOT / path))
        return [nodes.raw("", f'<div class="topokit-film">{figure._repr_html_()}</div>', format="html")]


def _figures_of_the_first_page(app: Any, docname: str, source: list[str]) -> None:
    """Put results into the first page: `{{ file: path/of/a/number }}`, with ` | %` or ` | ms` for a unit."""
    if docname != app.config.root_doc:
        return

    def number(match: re.Match[str]) -> str:
        whole = json.loads((ROOT / "book" / "results" / f"{match[1]}.json").read_text(encoding="utf-8"))
        value = _at(whole, match[2].split("/"))
        if match[3] == "%":
            return f"{100 * value:.0f}\u00a0%"
        if match[3] == "ms":
            return f"{value:.1f}\u00a0ms"
        return f"{value:,}"

    source[0] = re.sub(r"\{\{ (\w+): (\S+)(?: \| (\S+))? \}\}", number, source[0])


def _at(value: Any, path: list[str]) -> Any:
    """Return the value at a path in a file of results; a star is the sum over a list."""
    for k, key in enumerate(path):
        if key == "*":
            return sum(_at(item, path[k + 1 :]) for item in value)
        value = value[int(key) if isinstance(value, list) else key]
    return value


# ---- the head of each page, and files beside the pages --------------------------------------------------------------


def _head(app: Any, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    about = dict(TOPICS.findall((ROOT / "book" / "chapters.md").read_text(encoding="utf-8"))).get(pagename, DESCRIPTION)
    # An ARIA list must have ARIA items, which docutils does not write here.
    body = context.get("body", "").replace('role="list" class="citation-list"', 'class="citation-list"')
    context["body"] = _TABLE.sub(_captioned, _FRAME.sub(_framed, body))
    tags = [f'<meta name="description" content="{html.escape(about)}">']
    tags += [f'<meta property="og:{key}" content="{html.escape(value)}">' for key, value in _card(app, about).items()]
    context["metatags"] = context.get("metatags", "") + "\n".join(tags) + "\n"
    if pagename == app.config.root_doc:
        context["title"] = "the loops of cloth, found and followed"
    if pagename == "search":
        for script in ("texts.js", "search_here.js"):
            app.add_js_file(script)


# A data frame of pandas: a line in bold before it, its own styles, and a head of one row or of two.
_FRAME = re.compile(
    r'(?:<p>(?P<caption><strong>(?:(?!</p>).)*)</p>\s*)?<div class="output text_html"><div>\s*<style scoped>.*?</style>\s*'
    r'<table border="1" class="dataframe">\s*<thead>(?P<head>.*?)</thead>',
    re.DOTALL,
)
_ROW = re.compile(r"<tr[^>]*>(.*?)</tr>", re.DOTALL)
_TABLE = re.compile(r'<table class="table">(?!\s*<caption)')


def _framed(frame: re.Match[str]) -> str:
    """Return the beginning of a data frame with one row for its head, and the line before it as its caption."""
    columns, *index = _ROW.findall(frame["head"])
    name = re.search(r"<th>(.*?)</th>", index[0] if index else columns)[1]
    head = re.sub(r"<th>.*?</th>", f"<th>{name}</th>", columns, count=1)
    caption = f"<caption>{frame['caption']}</caption>" if frame["caption"] else ""
    table = f'<table class="table dataframe">{caption}<thead><tr>{head}</tr></thead>'
    return f'<div class="output text_html"><div class="pst-scrollable-table-container">{table}'


def _captioned(table: re.Match[str]) -> str:
    """Return the beginning of a table with the heading above it as a caption for those who hear the page."""
    headings = re.findall(r"<h\d>(.*?)<a", table.string[: table.start()], re.DOTALL)
    words = re.sub(r"<[^>]*>", "", headings[-1]) if headings else "Table"
    return f'<table class="table"><caption class="visually-hidden">{words}</caption>'


def _card(app: Any, about: str) -> dict[str, str]:
    """Return what other sites show where somebody links to a page."""
    site = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Documentation"]
    return {"site_name": app.config.project, "description": about, "image": f"{site}/_static/apron.png"}


def _finish(app: Any, error: Exception | None) -> None:
    if error is not None or app.builder.name != "html":
        return
    out = Path(app.outdir)
    page = '<!doctype html><html lang="en"><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=book/index.html">'
    page += '<title>topokit</title><a href="book/index.html">topokit</a>\n'
    (out / "index.html").write_text(page, encoding="utf-8")
    thumbnails = out / "_static" / "thumbnails"
    thumbnails.mkdir(parents=True, exist_ok=True)
    for chapter in filter(is_chapter, app.env.found_docs):
        picture = Path(shutil.copy(thumbnail(app, chapter), thumbnails))
        if picture.suffix == ".png":
            with Image.open(picture) as whole:
                whole.thumbnail((640, 640))
                whole.save(picture)
    for leftover in (*(out / "_static").rglob("*.map"), *(out / "_static").rglob("*.html")):
        leftover.unlink()
    _fewer_icons(out)
    _texts_to_search(app, out)


_ICON = re.compile(
    r'(?<=[{,])("[a-z0-9-]+"|[a-z0-9]+):\[\d+,\d+,\[[^\]]*\],"[0-9a-f]+",(?:"[^"]*"|\["[^"]*","[^"]*"\])\]'
)


def _fewer_icons(out: Path) -> None:
    """Keep only the icons of Font Awesome that the pages show: 1.5 MB less to load."""
    script = out / "_static" / "scripts" / "fontawesome.js"
    pages = [path.read_text(encoding="utf-8") for path in out.rglob("*.html")]
    code = [path.read_text(encoding="utf-8") for path in (out / "_static").rglob("*.js") if path != script]
    used = {name for text in pages + code for name in re.findall(r"\bfa-([a-z0-9-]+)", text)}
    whole = script.read_text(encoding="utf-8")
    kept = _ICON.sub(lambda m: m[0] if m[1].strip('"') in used else "_:0", whole)
    script.write_text(re.sub(r"(?<=[{,])_:0,|,?_:0(?=})", "", kept), encoding="utf-8")


def _texts_to_search(app: Any, out: Path) -> None:
    """Write the words of all pages into one script for the search page: a local page may not read files beside it."""
    texts = {}
    for docname in app.env.found_docs:
        doctree = app.env.get_doctree(docname)
        texts_of = (node for node in doctree.findall(nodes.TextElement) if not isinstance(node, nodes.raw))
        words = [node.astext() for node in texts_of if not isinstance(node.parent, nodes.TextElement)]
        texts[docname] = re.sub(r"\s+", " ", " ".join(words))
    code = "const TEXTS = " + json.dumps(texts, ensure_ascii=False) + ";\n"
    (out / "_static" / "texts.js").write_text(code, encoding="utf-8")
