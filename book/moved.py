"""Old addresses of chapters: each keeps a small page that leads to the new one."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

# The page of a chapter that was divided leads to its first half.
MOVED = {
    "02_persistence_and_the_edge_that_kills_a_loop": "02_the_edge_that_kills_a_loop",
    "03_seeing_a_shape_through_points": "03_what_a_sample_shows",
    "04_small_motions_small_changes": "04_what_a_motion_changes",
    "05_the_edge_that_knows_where_the_loop_is": "05_where_the_killer_is_and_where_it_leaps",
    "06_where_the_killer_goes_next": "05_where_the_killer_is_and_where_it_leaps",
    "08_a_world_of_aprons_bags_and_hooks": "10_a_world_of_aprons_bags_and_hooks",
    "09_from_episodes_to_a_dataset": "11_from_episodes_to_a_dataset",
    "10_loops_as_probability": "12_loops_as_probability",
    "11_learning_to_predict_topology": "13_learning_to_predict_topology",
    "12_predict_the_cloth_read_the_loop": "14_predict_the_cloth_read_the_loop",
    "13_honest_evaluation": "15_honest_evaluation",
    "14_linked_or_not": "09_linked_or_not",
    "15_hang_it": "16_hang_it",
    "16_your_own_garment": "appendix_c_your_own_garment",
}


def setup(app: Any) -> dict[str, bool]:
    app.connect("build-finished", _leave_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def page_that_leads_to(address: str) -> str:
    """Return a page that leads to an address beside it; with scripts, also to the same place on that page."""
    link = html.escape(address, quote=True)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>moved</title><link rel="canonical" href="{link}">'
        f'<script>location.replace("{link}" + location.search + location.hash)</script>'
        f'<meta http-equiv="refresh" content="1; url={link}"><p>This chapter is now at <a href="{link}">{link}</a>.</p>\n'
    )


def _leave_pages(app: Any, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        for old, new in MOVED.items():
            page = Path(app.outdir) / "notebooks" / f"{old}.html"
            page.write_text(page_that_leads_to(f"{new}.html"), encoding="utf-8")
