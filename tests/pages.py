"""The pages of topokit.view for tests: the data inside, and their scripts, run by node."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from importlib import resources

import pytest

from topokit.view._pages import Framed

needs_node = pytest.mark.skipif(
    shutil.which("node") is None, reason="node, which runs the page's script, is not installed"
)
NETWORK = re.compile(r"https?:|//[a-z]+\.[a-z]|@import|url\(|<link|src=|fetch\(|XMLHttpRequest|WebSocket")


def check_small_and_whole(figure: Framed) -> None:
    """Nothing of the network is asked for, nothing is left to fill in, no text of the data ends a script."""
    assert not NETWORK.search(figure.page)
    assert "__" not in figure.page  # nothing left to fill in
    assert figure.page.count("</script>") == 2
    assert len(figure.page) < 40_000


def page_data(figure: Framed) -> dict:
    """What the script is given."""
    return json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', figure.page, re.DOTALL).group(1))


def by_script(scripts: list[str], call: str, given: object) -> list:
    """What `call`, an arrow function, makes of every item of `given`, with the functions of `scripts` at hand."""
    files = resources.files("topokit.view")
    code = "\n".join(files.joinpath(name).read_text(encoding="utf-8") for name in scripts)
    code += '\nconst given = JSON.parse(require("fs").readFileSync(0, "utf8"));\n'
    code += f"console.log(JSON.stringify(given.map({call})));"
    done = subprocess.run(["node", "-e", code], input=json.dumps(given), capture_output=True, text=True, check=True)
    return json.loads(done.stdout)
