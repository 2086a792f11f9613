"""How long a chapter takes to read, from its words and its visible code, and to work through, from its exercises."""

from __future__ import annotations

from typing import Any

WORDS_A_MINUTE = 120  # of text with mathematics
LINES_A_MINUTE = 10  # of code
MINUTES_AN_EXERCISE = 40  # and a reader does every second one
EXERCISES = "## Exercises"
HIDDEN = {"hide-input", "hide-cell", "remove-input"}  # tags of cells whose code is folded


def time_needed(notebook: dict[str, Any]) -> str:
    """Return the time to read a chapter up to its exercises, and the time to work through it with half of them."""
    minutes = minutes_to_read(notebook)
    text = f"{minutes} min to read"
    exercises = sum("".join(cell["source"]).count(":::{exercise}") for cell in notebook["cells"])
    if exercises:
        hours = round((minutes + exercises / 2 * MINUTES_AN_EXERCISE) / 30) / 2
        text += f", {hours:g} h to work through"
    return text


def minutes_to_read(notebook: dict[str, Any]) -> int:
    """Return the time to read text and visible code up to the exercises, rounded to five minutes."""
    minutes = 0.0
    for cell in notebook["cells"]:
        text, heading, _ = "".join(cell["source"]).partition(EXERCISES)
        if cell["cell_type"] == "markdown":
            minutes += len(text.split()) / WORDS_A_MINUTE
        elif not HIDDEN & set(cell["metadata"].get("tags", ())):
            minutes += len(text.splitlines()) / LINES_A_MINUTE
        if heading:
            break
    return max(5, 5 * round(minutes / 5))
