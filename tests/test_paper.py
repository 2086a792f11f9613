"""What the book's map of the paper names exists; every theorem has a proof or a source, every exercise a hint and a solution."""

from __future__ import annotations

import importlib
import json
import re
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAP = (ROOT / "book" / "paper.md").read_text()
ITEMS = {"Definition": 3, "Assumption": 3, "Lemma": 5, "Corollary": 1, "Algorithm": 1, "Equation": 1, "Figure": 4}


def pages() -> dict[str, str]:
    """The text of every chapter and page, by file name."""
    texts = {path.name: path.read_text() for path in (ROOT / "book").glob("*.md")}
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = json.loads(path.read_text())["cells"]
        texts[path.name] = "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
    return texts


PAGES = pages()
ALL = "\n".join(PAGES.values())


def resolve(name: str) -> object:
    """The thing of a dotted name: the longest module, then attributes."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            # A field of a dataclass without a default is annotated, and no attribute of the class.
            thing = (
                thing.__annotations__[part] if part in vars(thing).get("__annotations__", {}) else getattr(thing, part)
            )
        return thing
    raise ModuleNotFoundError(name)


def test_every_item_of_the_paper_has_an_entry():
    for item, count in ITEMS.items():
        assert [int(k) for k in re.findall(rf"^{item} (\d)", MAP, re.M)] == list(range(1, count + 1)), item


def test_every_entry_names_a_chapter():
    entries = re.findall(r"^(.+)\n: (.+)\n: (.+)$", MAP, re.M)
    assert len(entries) == MAP.count("\n: The paper: ") > 25
    assert all("../notebooks/" in places for _, _, places in entries)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(topokit[\w.]+)`", MAP))))
def test_every_function_of_the_map_exists(name):
    assert resolve(name) is not None


def test_every_link_to_a_chapter_leads_there():
    for page, text in PAGES.items():
        folder = ROOT / ("notebooks" if page.endswith(".ipynb") else "book")
        for link in re.findall(r"\]\(([^)#\s]+\.(?:ipynb|md))[)#]", text):
            assert (ROOT / link[1:] if link.startswith("/") else folder / link).exists(), f"{page}: {link}"


def test_every_chapter_is_in_the_table_of_contents():
    listed = re.findall(r"^/notebooks/(\w+)$", PAGES["index.md"], re.M)
    assert sorted(listed) == sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))


def test_labels_are_given_once_and_references_have_one():
    given = Counter(re.findall(r"^:label: (\S+)$", ALL, re.M))
    assert max(given.values()) == 1
    assert set(re.findall(r"\{(?:prf:ref|numref)\}`(?:[^`<]*<)?([^`>]+)>?`", ALL)) <= set(given)


def test_every_theorem_has_a_proof_or_a_source_with_the_place():
    """A statement in an environment is followed by its proof, or cites a work and says where in it, by number or by name."""
    place = r"\{cite:p\}`[^`]+` \(((Theorem|chapter|section) [\w.]+|(the )?\*[^*]+\*|the theorem of its abstract)\)"
    seen = Counter()
    for page, text in PAGES.items():
        for match in re.finditer(r"^:::\{prf:(theorem|proposition|lemma|corollary)\}.*?^:::$", text, re.M | re.S):
            seen[match[1]] += 1
            proof = text.find(":::{prf:proof}", match.end())
            after = text.find(":::{prf:", match.end())
            sourced = re.search(place, match[0])
            assert sourced or 0 <= proof == after, f"{page}: {match[0].splitlines()[1]}"
    assert seen["theorem"] >= 10


@pytest.mark.parametrize("chapter", [f"{k:02}" for k in range(17)])
def test_every_exercise_says_its_level_and_has_a_hint_and_a_folded_solution(chapter):
    (path,) = (ROOT / "notebooks").glob(f"{chapter}*.ipynb")
    cells, levels = json.loads(path.read_text())["cells"], []
    for cell, after in zip(cells, [*cells[1:], {"metadata": {}}], strict=True):
        for asked in re.findall(r"^::::\{exercise\}.*?^::::$", "".join(cell["source"]), re.M | re.S):
            levels += [re.search(r":label: ex-[\w-]+\n\n\*\*([\w -]+)\.\*\* ", asked)[1]]
            assert "<summary>Hint</summary>" in asked
            folded = "hide-cell" in after["metadata"].get("tags", [])
            assert not folded or after["metadata"]["jupyter"]["source_hidden"]  # folded in JupyterLab too
            assert (
                "<summary>What is known</summary>" in asked if "Open" in levels[-1] else folded or "Solution</" in asked
            )
    assert set(levels) - {"Project"} == {"Warm-up", "Exercise", "Proof", "Open question"}
