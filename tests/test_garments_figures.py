"""What README says of strangers' meshes is what was measured: book/results/garments.json."""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_readme_says_what_became_of_the_bag():
    results = json.loads((ROOT / "book" / "results" / "garments.json").read_text())
    rows, words = results["meshes"], " ".join((ROOT / "README.md").read_text().split())
    garments = [row for row in rows if row["expected"] == "hangs"]
    others = [row for row in garments if row["mesh"].startswith("not ours")]
    counts = {what: sum(row["outcome"] == what for row in rows) for what in ("hangs", "does not hang", "refused")}
    assert {name: results[name] for name in counts} == counts
    assert {row["outcome"] for row in rows if row["expected"] == "refused"} == {"refused"}
    assert len(others) == 3
    assert f"Of {len(rows)} files, {len(garments)} garments as other tools write them" in words
    assert f"{counts['hangs']} hang at the end of the film, and {counts['refused']} are refused" in words
