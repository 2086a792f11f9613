"""Write the chapters for JupyterLab, in plain Markdown: python book/lab.py

The chapters are written in MyST, whose roles and directives only the book resolves. Other readers of notebooks show them as they
are: {term}`loop`, :::{prf:theorem}. The copies in runs/lab read well there. Terms show their meaning at the pointer, theorems
and exercises are called by their titles, equations by their labels, and citations by author and year. Captions stand in cells
below their figures. Solutions are below a collapsed heading, since JupyterLab shows an output that it has made anew.

A copy that its reader has changed is kept.
"""

from __future__ import annotations

import hashlib
import html
import json
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pybtex.database import parse_file
from times import time_needed

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "notebooks"))
from chapter_tools.quiz import label  # noqa: E402

BESIDE = ("book", "data_small")  # folders that chapters read
WRITTEN = "written.json"  # checksums of the copies as they were written
NOTE = (
    "> *This copy is for JupyterLab. A word with a dotted line shows its meaning at the pointer. Theorems, exercises and "
    "equations have names here; the book (`make book`) numbers them, links to them, and has an index.*"
)
#: The last line of each chapter's first cell, which the book hides and the copies leave out.
OUTSIDE = (
    '<p class="topokit-outside">Outside of the book, terms, references and citations in braces stay unresolved. '
    "<code>make lab</code> opens copies of the chapters in plain Markdown.</p>"
)
_FENCE = re.compile(r"^(:{3,})\{([a-z:]+)\} *([^\n]*)\n((?::[a-z]+:[^\n]*\n)*)(.*?)^\1 *$", re.MULTILINE | re.DOTALL)
_ROLE = re.compile(r"\{([a-z:]+)\}`([^`]+)`")
_TAGGED = re.compile(r"\$\$((?:(?!\$\$).)+?)\$\$ *\(([a-z0-9-]+)\)", re.DOTALL)
_IMAGE = re.compile(r"^```\{image\} *(\S+)\n((?::[a-z]+:.*\n)*)```$", re.MULTILINE)
# A role, or code, which is left as it is.
_ROLE_OR_CODE = re.compile(r"\{([a-z:]+)\}`([^`]+)`|^```.*?^```$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
_NAMES = {"margin": "Note", "prf:proof": "Proof"}


@dataclass
class Names:
    """The names by which the chapters refer to each other."""

    meanings: dict[str, str]  #: of the glossary's terms, by their small letters
    citations: dict[str, tuple[str, str]]  #: author and year, by key
    places: dict[str, tuple[str, str]] = field(default_factory=dict)  #: file and name of what has a label

    def add(self, file: str, source: str) -> None:
        """Take in the labels of a chapter's cell."""
        for _, kind, title, options, body in _FENCE.findall(source):
            label = re.search(r":label: *(\S+)", options)
            if label:
                name = kind.removeprefix("prf:")
                self.places[label[1]] = (file, f"{name} *{title}*" if title else name)
            self.add(file, body)
        for _, label in _TAGGED.findall(source):
            self.places[label] = (file, f"({label})")


def main(folder: Path = ROOT / "runs" / "lab") -> None:
    """Write a copy of each chapter, with links to the folders that it reads."""
    chapters = {path.name: json.loads(path.read_text()) for path in sorted((ROOT / "notebooks").glob("*.ipynb"))}
    names = Names(glossary(ROOT / "book" / "glossary.md"), bibliography(ROOT / "book" / "references.bib"))
    for page in sorted((ROOT / "book").glob("*.md")):
        names.add(f"../book/{page.name}", page.read_text())
    for file, chapter in chapters.items():
        for cell in chapter["cells"]:
            names.add(file, "".join(cell["source"]))
    _link_beside(folder)
    _write(folder, {file: _plain_chapter(chapter, names, file) for file, chapter in chapters.items()})


def plain(source: str, names: Names, file: str = "") -> str:
    """Return the Markdown of a chapter's cell without what only MyST understands.

    Parameters
    ----------
    source : str
    names : Names
    file : str
        The chapter's own file, to which no link is needed.
    """
    text = source.replace(OUTSIDE, "")
    while _FENCE.search(text):
        text = _FENCE.sub(lambda match: _box(*match.groups()[1:]), text)
    text = text.replace("</summary>", " (click to open)</summary>")  # the mark before it is not seen everywhere
    text = _IMAGE.sub(lambda match: f"![{_option(match[2], 'alt')}]({match[1]})", text)
    text = _TAGGED.sub(lambda match: f"$${match[1].rstrip()} \\tag{{{match[2]}}} $$", text)
    return _ROLE_OR_CODE.sub(lambda match: _role(match[1], match[2], names, file) if match[1] else match[0], text)


def _box(kind: str, title: str, options: str, body: str) -> str:
    """Return an exercise as a section, and any other directive as a quotation with its kind and title."""
    name = _NAMES.get(kind, kind.removeprefix("prf:").capitalize())
    if kind == "exercise":
        return f"### {name}: {title}\n\n{body.strip()}\n"
    head = f"**{name}{f' ({title})' if title else ''}.**"
    return "\n".join(f"> {line}".rstrip() for line in f"{head} {body.strip()}".split("\n"))


def _option(options: str, name: str) -> str:
    found = re.search(rf"^:{name}: *(.*)$", options, re.MULTILINE)
    return found[1] if found else ""


def _role(kind: str, content: str, names: Names, file: str) -> str:
    """Return what a role shows."""
    content = " ".join(content.split())
    if kind.startswith("cite:"):
        return _cited([key.strip() for key in content.split(",")], kind == "cite:t", names.citations)
    shown, target = re.fullmatch(r"(?:(.*?) *<)?([^<>]*)>?", content).groups()  # type: ignore[union-attr]
    if kind == "term":
        meaning = names.meanings[target.lower()]
        return f'<abbr title="{html.escape(meaning)}">{shown or target}</abbr>'
    place, name = names.places[target]
    return (shown or name) if place == file else f"[{shown or name}]({place})"


def _cited(keys: list[str], in_text: bool, citations: Mapping[str, tuple[str, str]]) -> str:
    parts = []
    for key in keys:
        author, year = citations[key]
        parts.append(f"{author} ({year})" if in_text else f"{author} {year}")
    return ", ".join(parts) if in_text else f"({'; '.join(parts)})"


def glossary(path: Path) -> dict[str, str]:
    """Return the meaning of each term of the glossary in plain words."""
    meanings = {}
    entries = re.findall(r"^(\S.*)\n((?:  .*\n)+)", path.read_text(), re.MULTILINE)
    for terms, meaning in entries:
        words = " ".join(_ROLE.sub(lambda match: re.sub(r" *<.*>", "", match[2]), meaning).split())
        meanings |= dict.fromkeys([terms.lower(), *terms.lower().split(", ")], re.sub(r"[*$`]", "", words))
    return meanings


def bibliography(path: Path) -> dict[str, tuple[str, str]]:
    """Return authors and year of each entry of a BibTeX file."""
    entries = {}
    for key, entry in parse_file(path).entries.items():
        authors = [" ".join(map(str, person.rich_last_names)) for person in entry.persons["author"]]
        shown = f"{authors[0]} et al." if len(authors) > 2 else " and ".join(authors)
        entries[key] = (shown, entry.fields["year"])
    return entries


def _plain_chapter(chapter: dict, names: Names, file: str) -> str:
    """Return the text of a notebook in plain Markdown, with a note in its first cell, headings of solutions, and captions."""
    cells = []
    figures = 0
    for cell in chapter["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            source = plain(source, names, file)
        if not cells:
            source = f"{source.rstrip()}\n\n{time_needed(chapter)}\n\n{NOTE}"
        shown = cell["metadata"].get("mystnb", {})
        if "hide-cell" in cell["metadata"].get("tags", ()):
            heading = (
                shown["code_prompt_show"].removeprefix("Show ").removeprefix("a ").removeprefix("the ").capitalize()
            )
            cells.append(_text(f"{cell['id']}-heading", f"#### {heading}", {"jp-MarkdownHeadingCollapsed": True}))
        cells.append({**cell, "source": source.splitlines(keepends=True)})
        caption = shown.get("figure", {}).get("caption")
        if caption:
            figures += 1
            text = f"**Fig. {label(file)}.{figures}** {plain(caption, names, file)}"
            cells.append(_text(f"{cell['id']}-caption", text, {}))
    return json.dumps({**chapter, "cells": cells}, indent=1, ensure_ascii=False) + "\n"


def _text(name: str, text: str, metadata: dict) -> dict:
    """Return a cell of text."""
    return {"cell_type": "markdown", "id": name, "metadata": metadata, "source": text}


def _link_beside(folder: Path) -> None:
    """Link to the folders that chapters read, and to all that lies beside the notebooks."""
    (folder / "notebooks").mkdir(parents=True, exist_ok=True)
    beside = [ROOT / name for name in BESIDE]
    beside += [path for path in (ROOT / "notebooks").iterdir() if path.suffix != ".ipynb" and path.name[0] not in "._"]
    for path in beside:
        link = folder / path.relative_to(ROOT)
        if not link.is_symlink():
            link.symlink_to(path)


def _write(folder: Path, texts: Mapping[str, str]) -> None:
    """Write the copies, but those that differ from what was written last time."""
    record = folder / WRITTEN
    written = json.loads(record.read_text()) if record.exists() else {}
    for file, text in texts.items():
        path = folder / "notebooks" / file
        if path.exists() and hashlib.sha256(path.read_bytes()).hexdigest() != written.get(file):
            print(f"{path}: kept, since you changed it; remove it for the chapter as it is now")
            continue
        path.write_text(text)
        written[file] = hashlib.sha256(text.encode()).hexdigest()
    record.write_text(json.dumps(written, indent=1))


if __name__ == "__main__":
    main()
