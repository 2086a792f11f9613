"""The book as one page, `_build/paper.html`, and that page printed by the Chromium of the machine, `_build/topokit.pdf`.

    make pdf

The articles of the built pages stand one after another; links between them stay inside. Moving figures are printed as they stand,
hints are open, code that is folded stays so. The reference of functions and the tables of results are for the screen.
"""

from __future__ import annotations

import os
import posixpath
import re
import shutil
import subprocess
from pathlib import Path

BUILD = Path(__file__).resolve().parent.parent / "_build"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FIRST = "book/index.html"
ARTICLE = re.compile(r'<article class="bd-article"[^>]*>(.*?)</article>', re.DOTALL)
CHILD = re.compile(r'<li class="toctree-l\d[^"]*"><a class="reference internal" href="([^"#]+\.html)"')
LINK = re.compile(r'(\b(?:xlink:)?href|\bsrc)="(?!\w+:|data:)([^"#]*)(#[^"]*)?"')
STYLE = """<style>
@page { size: A4; margin: 16mm 14mm; }
html { font-size: 85%; }
article { break-before: page; max-width: 46rem; margin: 0 auto; }
.cell, figure, .math, .topokit-plot, table { break-inside: avoid; }
h1, h2, h3 { break-after: avoid; }
.headerlink, .topokit-takes a[download], .topokit-elsewhere, .topokit-gif button, .topokit-copy { display: none !important; }
</style>"""


def order(html: Path) -> list[str]:
    """The pages for paper, in the order of the table of contents."""
    text = (html / FIRST).read_text(encoding="utf-8")
    pages = [posixpath.normpath(posixpath.join("book", href)) for href in CHILD.findall(text)]
    return [page for page in dict.fromkeys([FIRST, *pages]) if not page.startswith(("book/api", "book/report"))]


def article(html: Path, pages: list[str], page: str) -> str:
    """What a page says, its names made its own, its links led to the other pages' names."""
    text = ARTICLE.search((html / page).read_text(encoding="utf-8"))[1]
    own = pages.index(page)

    def lead(link: re.Match[str]) -> str:
        kind, path, anchor = link[1], link[2], link[3] or ""
        if not path:
            return f'{kind}="#p{own}-{anchor[1:]}"'
        target = posixpath.normpath(posixpath.join(posixpath.dirname(page), path))
        if target in pages:
            return f'{kind}="#p{pages.index(target)}-{anchor[1:]}"'
        return f'{kind}="html/{target}{anchor}"'

    text = re.sub(r'\bid="', f'id="p{own}-', LINK.sub(lead, text)).replace("url(#", f"url(#p{own}-")
    text = text.replace('loading="lazy"', 'loading="eager"').replace("<details>", "<details open>")
    return f'<article class="bd-article" id="p{own}-">{text}</article>'


def whole(html: Path) -> str:
    """The one page, for a file beside the folder of the built book, which it takes its looks from."""
    pages = order(html)
    chapter = next(page for page in pages if 'class="math' in (html / page).read_text(encoding="utf-8"))
    head = re.search(r"<head>(.*?)</head>", (html / chapter).read_text(encoding="utf-8"), re.DOTALL)[1]
    head = re.sub("<title>.*?</title>", "<title>topokit</title>", head, flags=re.DOTALL)
    head = LINK.sub(lambda link: f'{link[1]}="html/{posixpath.normpath(posixpath.join("book", link[2]))}"', head)
    articles = "\n".join(article(html, pages, page) for page in pages)
    body = f'<div class="bd-content"><main class="bd-main">{articles}</main></div>'
    root = '<html lang="en" data-theme="light" data-mode="light" data-default-mode="light" data-content_root="html/">'
    return f"<!doctype html>{root}<head>{head}{STYLE}</head><body><div>{body}</div></body></html>"


def print_page(page: Path, pdf: Path) -> None:
    """Print a page of a disk, without a network; the time is the page's own, so that all figures are drawn."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise SystemExit(f"no Chromium on this machine (apt-get install chromium); the page is {page.as_uri()}")
    options = ["--headless", "--no-pdf-header-footer", "--virtual-time-budget=60000", "--use-angle=swiftshader"]
    options += ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
    subprocess.run([browser, *options, f"--print-to-pdf={pdf}", page.as_uri()], check=True, stderr=subprocess.DEVNULL)


if __name__ == "__main__":
    page, pdf = BUILD / "paper.html", BUILD / "topokit.pdf"
    page.write_text(whole(BUILD / "html"), encoding="utf-8")
    print_page(page, pdf)
    print(f"The book on paper: {pdf.as_uri()} ({pdf.stat().st_size / 1e6:.0f} MB); as one page: {page.as_uri()}")
