"""The sentences of README and of the chapters with measured numbers say what was measured (tests/ledger.py lists them)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ledger import ASSERTED, GIVEN, MEASURED

ROOT = Path(__file__).parent.parent
NAMES = ["an_apron_finds", "point_clouds", "persistence_and", "seeing_a", "small_motions", "the_edge_that"]
NAMES += ["where_the", "seqph_following", "a_world_of", "from_episodes", "loops_as"]
NAMES += ["learning_to_predict", "predict_the", "honest_evaluation", "linked_or", "hang_it", "your_own"]
CHAPTERS = {name: path for name in NAMES for path in ROOT.glob(f"notebooks/??_{name}*.ipynb")}
PAGES = ["README.md", "CONTRIBUTING.md", *CHAPTERS]

WORD = "one|two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|thirteen"
WORD += "|twenty|thirty|forty|fifty|sixty|hundred|thousand|half"
NUMBER = rf"(?:\d[\d,.]*\d|\d|\b(?:{WORD}))"
UNIT = "mm|cm|ms|GB|kB|MB|nats|centimetres?|millimetres?|micrometres?|times|hundredths"
THINGS = "episodes|windows|films|runs|trainings|tasks|switches|garments"
COUNTED = re.compile(
    rf"{NUMBER}(?: ?%| per cent| (?:{UNIT}|{THINGS})\b| (?:of|in|out of) (?:the )?{NUMBER}\b)", re.IGNORECASE
)


def cells_of(page: str, kind: str) -> list[str]:
    cells = json.loads(CHAPTERS[page].read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == kind]


def captions_of(page: str) -> list[str]:
    """Captions and text alternatives of a chapter's figures."""
    cells = [cell["metadata"].get("mystnb", {}) for cell in json.loads(CHAPTERS[page].read_text())["cells"]]
    return [cell["figure"]["caption"] + "\n\n" + cell["image"]["alt"] for cell in cells if "figure" in cell]


def prose_of(page: str) -> str:
    """What is said, in one line: links by their words, without blocks of code, of formulas, and tables that other tests hold."""
    text = (
        (ROOT / page).read_text()
        if page.endswith(".md")
        else "\n\n".join([*captions_of(page), *cells_of(page, "markdown")])
    )
    text = re.sub(r"<!--.*?-->.*?<!--.*?-->|```.*?```|\$\$.*?\$\$", " ", text, flags=re.DOTALL)
    return " ".join(re.sub(r"!?\[([^]]*)\]\([^)]*\)", r"\1", text).split())


def numbers_in(prose: str) -> Iterator[re.Match[str]]:
    """Numbers with a unit, or of something that is counted; what stands in code or in a formula is no prose."""
    told = prose.partition("## Exercises")[0]  # the exercises ask, and their solutions assert
    return COUNTED.finditer(re.sub(r"`[^`]*`|\$[^$]*\$", lambda span: "~" * len(span[0]), told))


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    found = {path.stem: json.loads(path.read_text()) for path in (ROOT / "book" / "results").glob("*.json")}
    return found | {"datasets/motion": json.loads((ROOT / "book" / "datasets" / "motion.json").read_text())}


@pytest.fixture(scope="module")
def prose() -> dict[str, str]:
    return {page: prose_of(page) for page in PAGES}


def is_said(prose: dict[str, str], results: dict[str, Any], claim: tuple[str, str, Any]) -> bool:
    page, sentence, values = claim
    return sentence.format(*values(results)) in prose[page]


def test_what_is_said_is_what_the_files_say(prose, results):
    wrong = [claim for claim in MEASURED if not is_said(prose, results, claim)]
    should = [f"{page} should say: {sentence.format(*values(results))}" for page, sentence, values in wrong]
    assert not should, "\n".join(should)


class Notes(dict):
    """The results, with a note of which files were asked for."""

    def __init__(self, files: dict[str, Any]):
        super().__init__(files)
        self.asked: set[str] = set()

    def __getitem__(self, name: str) -> Any:
        self.asked.add(name)
        return super().__getitem__(name)


OUTCOMES = ("hangs", "refused")


def spoilt(value: Any, count: list[int]) -> Any:
    """A copy in which every number is another one, each by a share of its own, yes is no, and every list has one entry more."""
    if isinstance(value, dict):
        return {key: spoilt(item, count) for key, item in value.items()}
    if isinstance(value, list):
        return [spoilt(item, count) for item in [*value, *value[-1:]]]
    if isinstance(value, str):
        return "" if value in OUTCOMES else value.replace("--episodes ", "--episodes 9")
    if isinstance(value, bool):
        return not value
    if value is None:
        return None
    count[0] += 1
    return type(value)(value * (1.3 + 0.1 * (count[0] % 7)) + 1 + count[0] % 3)


def test_a_sentence_fails_when_its_file_changes(prose, results):
    depend: dict[str, int] = {}
    for claim in MEASURED:
        notes = Notes(results)
        claim[2](notes)
        for name in notes.asked:
            depend[name] = depend.get(name, 0) + 1
            results_of = {**results, name: copies(name, results)}
            assert not is_said(prose, results_of, claim), f"{claim[1]} stays when {name} changes"
    assert depend == {
        "datasets/motion": 1,
        "foreseeable": 4,
        "garments": 2,
        "hanging": 8,
        "lemmas_on_cloth": 2,
        "lemmas_on_test": 9,
        "motion": 6,
        "predictors": 2,
        "simulation": 5,
        "tracking": 10,
        "unseen": 7,
    }


def copies(name: str, results: dict[str, Any], made: dict[str, Any] = {}) -> Any:  # noqa: B006
    """The spoilt copy of a file, made once."""
    if name not in made:
        made[name] = spoilt(results[name], [0])
    return made[name]


def test_what_is_said_of_a_cell_is_asserted_there(prose):
    for page, sentence, code in ASSERTED:
        assert sentence in prose[page], f"{page} does not say: {sentence}"
        assert any(code in cell for cell in cells_of(page, "code")), f"{page} asserts nothing like: {code}"


def test_every_number_has_a_source(prose, results):
    for page in PAGES:
        known = [sentence.format(*values(results)) for where, sentence, values in MEASURED if where == page]
        known += [sentence for where, sentence, _ in ASSERTED + GIVEN if where == page]
        spans = [(found.start(), found.end()) for text in known for found in re.finditer(re.escape(text), prose[page])]
        loose = [
            prose[page][max(number.start() - 60, 0) : number.end() + 40]
            for number in numbers_in(prose[page])
            if not any(start <= number.start() and number.end() <= end for start, end in spans)
        ]
        assert not loose, f"{page}, numbers without a source: {loose}"


def test_no_exemption_is_idle(prose):
    for page, sentence, reason in GIVEN:
        assert reason
        assert any(numbers_in(sentence)), f"{sentence} has no number that needs a source"
        assert sentence in prose[page], f"{page} does not say: {sentence}"


def test_every_figure_has_a_caption_and_a_text_alternative():
    for page in CHAPTERS:
        for cell in json.loads(CHAPTERS[page].read_text())["cells"]:
            drawn = re.search(r"plt\.(figure|subplots)\(", "".join(cell["source"]))
            if drawn and "hide-cell" not in cell["metadata"].get("tags", []):
                told = cell["metadata"].get("mystnb", {})
                assert told.get("figure", {}).get("caption"), f"{page}, {cell['id']}: no caption"
                assert told.get("image", {}).get("alt"), f"{page}, {cell['id']}: no text alternative"
