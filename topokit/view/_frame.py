"""A figure that moves without a kernel: a small page of its own, with its data inside, in a frame.

Idea: the data are packed once beside scripts without dependencies, and the page is handed to the browser as the `srcdoc`
of an iframe. So it works the same in Jupyter, on a built page and as a file on a disk, and asks nothing of the network.
"""

from __future__ import annotations

import html
import json
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

__all__ = ["Framed", "framed_page"]


@dataclass(frozen=True, repr=False)
class Framed:
    """A moving figure; the last value of a notebook cell shows it.

    Attributes
    ----------
    page : str
        The whole HTML page, its data and its script inside.
    height : int
        Height of the frame around it in CSS pixels.
    title : str
        What the frame is called for readers who hear the page.
    """

    page: str
    height: int
    title: str

    def _repr_html_(self) -> str:
        source = html.escape(self.page, quote=True)
        return (
            f'<iframe srcdoc="{source}" title="{html.escape(self.title)}" loading="lazy" '
            f'style="width:100%;height:{self.height}px;border:0;display:block"></iframe>'
        )

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.title!r}, {len(self.page) / 1000:.0f} kB)"

    def save(self, path: str | Path) -> Path:
        """Write the figure as one HTML file that opens in any browser, and return its path."""
        path = Path(path)
        path.write_text(self.page, encoding="utf-8")
        return path


def framed_page(name: str, data: dict[str, Any], *scripts: str) -> str:
    """Put style, data and scripts into the page `name`.html: what the figures share, `scripts`, then `name`.js.

    A `</` inside the JSON could end the script element: it is escaped.
    """
    files = resources.files("topokit.view")
    page, style, *code = (
        files.joinpath(file).read_text(encoding="utf-8")
        for file in (f"{name}.html", "frame.css", "frame.js", *scripts, f"{name}.js")
    )
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    script = "(() => {\n" + "\n".join(code) + "})();"
    return page.replace("__STYLE__", style).replace("__SCRIPT__", script).replace("__DATA__", text)
