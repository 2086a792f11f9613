"""Read the data of an interactive figure, and run its scripts by node."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from topokit.view import HtmlFigure

ROOT = Path(__file__).parents[1]
FOLDERS = [ROOT / "notebooks" / "chapter_tools" / "figures", ROOT / "topokit" / "view"]
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node, which runs the scripts, is not installed")


def page_data(figure: HtmlFigure) -> dict:
    """Return the data that a figure's script reads."""
    return json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', figure.page, re.DOTALL)[1])


def unpack(packed: dict) -> np.ndarray:
    """Return the array that a figure's script unpacks."""
    values = np.frombuffer(base64.b64decode(packed["values"]), dtype="<" + packed["type"]).reshape(packed["shape"])
    return values * packed["scale"] + packed["low"] if "scale" in packed else values


def by_script(scripts: list[str], call: str, given: object) -> list:
    """Return what `call`, a function that may be async, makes of each item of `given` with the functions of `scripts`."""
    paths = [next(folder / name for folder in FOLDERS if (folder / name).exists()) for name in scripts]
    code = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    code += '\nconst given = JSON.parse(require("fs").readFileSync(0, "utf8"));\n'
    code += f"Promise.all(given.map({call})).then((answers) => console.log(JSON.stringify(answers)));"
    done = subprocess.run(["node", "-e", code], input=json.dumps(given), capture_output=True, text=True, check=True)
    return json.loads(done.stdout)
