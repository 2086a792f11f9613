"""Read the data of an interactive figure, and run its scripts by node or in Chromium."""

from __future__ import annotations

import base64
import html
import json
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

from topokit.view import HtmlFigure

ROOT = Path(__file__).parents[1]
FOLDERS = [ROOT / "notebooks" / "chapter_tools" / "figures", ROOT / "topokit" / "view"]
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
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
    code = _code_of(scripts)
    code += '\nconst given = JSON.parse(require("fs").readFileSync(0, "utf8"));\n'
    code += f"Promise.all(given.map({call})).then((answers) => console.log(JSON.stringify(answers)));"
    done = subprocess.run(["node", "-e", code], input=json.dumps(given), capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def by_browser(scripts: list[str], call: str, given: object) -> list:
    """Return the same as `by_script`, from a page that Chromium opens; from node where there is no Chromium."""
    if CHROMIUM is None:
        return by_script(scripts, call, given)
    code = f"{_code_of(scripts)}\nconst given = {json.dumps(given)};\n"
    code += f'document.querySelector("pre").textContent = JSON.stringify(given.map({call}));'
    is_root = hasattr(os, "geteuid") and os.geteuid() == 0
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        page.write_text(f'<!doctype html><meta charset="utf-8"><pre></pre><script>{code}</script>', encoding="utf-8")
        options = ["--headless", "--disable-gpu", f"--user-data-dir={folder}/profile", *["--no-sandbox"] * is_root]
        command = [CHROMIUM, *options, "--dump-dom", page.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    return json.loads(html.unescape(re.search("<pre>(.*?)</pre>", done.stdout, re.DOTALL)[1]))


def _code_of(scripts: list[str]) -> str:
    paths = [next(folder / name for folder in FOLDERS if (folder / name).exists()) for name in scripts]
    return "\n".join(path.read_text(encoding="utf-8") for path in paths)
