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

from topokit.view._palette import OKABE_ITO


@dataclass(frozen=True, repr=False)
class Framed:
    """A moving figure; the last value of a notebook cell shows it."""

    page: str  #: the whole HTML page, its data and its script inside
    height: int  #: of the frame in CSS pixels; a narrow page stacks the parts and takes more
    title: str  #: what the frame is called for readers who hear the page

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


def framed(name: str, scripts: tuple[str, ...], data: dict[str, Any], height: int, caption: str, title: str) -> Framed:
    """The page `name`: its parts, `name`.html, in the frame that all share, and its script, `name`.js, after `scripts`."""
    data = data | {"height": int(height), "title": caption, "palette": list(OKABE_ITO)}
    code = "\n".join(_text(script) for script in ("frame.js", *scripts, f"{name}.js"))
    parts = {
        "NAME": name,
        "STYLE": _text("frame.css"),
        "PARTS": _text(f"{name}.html"),
        "SCRIPT": f"(() => {{\n{code}}})();",
        "DATA": json.dumps(data, separators=(",", ":")).replace("</", "<\\/"),  # it could end the script element
    }
    page = _text("frame.html")
    for part, text in parts.items():
        page = page.replace(f"__{part}__", text)
    return Framed(page, height, title)


def _text(file: str) -> str:
    return resources.files("topokit.view").joinpath(file).read_text(encoding="utf-8")
