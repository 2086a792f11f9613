"""The whole book as one page, and that page as a PDF, printed by the Chromium of the machine.

    make pdf

`_build/single` is what Sphinx's builder singlehtml makes. Moving figures are loaded at once and printed as they stand; hints are
open, code that is folded stays so.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def whole(single: Path) -> Path:
    """Make the one page ready for paper: frames are loaded at once, hints are open, the theme is light."""
    page = single / "book" / "index.html"
    text = page.read_text(encoding="utf-8")
    text = text.replace('loading="lazy"', 'loading="eager"')
    text = text.replace("<details>", "<details open>")
    page.write_text(text.replace('data-default-mode="auto"', 'data-default-mode="light"'), encoding="utf-8")
    return page


def print_page(page: Path, pdf: Path) -> None:
    """Print a page of a disk, without a network; the time is the page's own, so that all figures are drawn."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise SystemExit(f"no Chromium on this machine (apt-get install chromium); the page is {page.as_uri()}")
    options = ["--headless", "--no-pdf-header-footer", "--virtual-time-budget=60000", "--use-angle=swiftshader"]
    options += ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    subprocess.run([browser, *options, f"--print-to-pdf={pdf}", page.as_uri()], check=True, stderr=subprocess.DEVNULL)


if __name__ == "__main__":
    pdf = ROOT / "_build" / "topokit.pdf"
    print_page(whole(Path(sys.argv[1])), pdf)
    print(f"The book on paper: {pdf.as_uri()} ({pdf.stat().st_size / 1e6:.0f} MB)")
