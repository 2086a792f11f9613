"""The copies of the chapters for JupyterLab: nothing is left that only the book understands, and no work of a reader is lost."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path

import pytest

pytest.importorskip("pybtex")

ROOT = Path(__file__).parents[1]
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(ROOT / "book")
    lab = importlib.import_module("lab")


def test_copies_of_all_chapters(tmp_path, capsys):
    lab.main(tmp_path)
    copies = sorted((tmp_path / "notebooks").glob("*.ipynb"))
    assert len(copies) == len(list((ROOT / "notebooks").glob("*.ipynb")))
    for copy in copies:
        cells = json.loads(copy.read_text())["cells"]
        original = {cell["id"]: cell for cell in json.loads((ROOT / "notebooks" / copy.name).read_text())["cells"]}
        assert lab.NOTE in "".join(cells[0]["source"])
        assert "".join(original[cells[0]["id"]]["source"]).endswith(f"\n\n{lab.OUTSIDE}")
        for cell in cells:  # captions and headings are new
            before = original.pop(cell["id"], None)
            if cell["cell_type"] == "code":
                assert cell == before
                continue
            prose = re.sub(r"^```.*?^```$|`[^`\n]+`", "", "".join(cell["source"]), flags=re.MULTILINE | re.DOTALL)
            assert not re.search(r"^:{2,}|^:[a-z]+:|\{[a-z]+:?[a-z]*\}`|\$\$ *\([a-z]|^%", prose, re.MULTILINE), (
                copy.name
            )
        assert not original
    # What the notebooks read lies beside their copies.
    assert (tmp_path / "notebooks" / "../data_small/apron_hook_0.npz").is_file()
    assert (tmp_path / "notebooks" / "chapter_tools" / "__init__.py").is_file()

    # A copy in which a reader has worked is kept; all others are written anew.
    copies[0].write_text("mine")
    copies[1].unlink()
    lab.main(tmp_path)
    assert copies[0].read_text() == "mine"
    assert copies[1].is_file()
    assert capsys.readouterr().out.count("kept") == 1
