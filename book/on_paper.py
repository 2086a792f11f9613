"""Make the book one page, `_build/paper.html`, and print it with the machine's Chromium, `_build/topokit.pdf`.

    make pdf

The page holds the articles of all built pages in order, and links between them stay inside. Interactive figures are printed as
they are first shown, hints are open, and folded code stays folded. The reference of functions and the tables of results are left
out.
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
    """Return the pages for paper, in the order of the table of contents."""
    text = (html / FIRST).read_text(encoding="utf-8")
    pages = [posixpath.normpath(posixpath.join("book", href)) for href in CHILD.findall(text)]
    return [page for page in dict.fromkeys([FIRST, *pages]) if not page.startswith(("book/api", "book/report"))]


def article(html: Path, pages: list[str], page: str) -> str:
    """Return the article of a page with unique ids and with links into the one page."""
    text = ARTICLE.search((html / page).read_text(encoding="utf-8"))[1]
    own = pages.index(page)

    def redirect(link: re.Match[str]) -> str:
        kind = link[1]
        path = link[2]
        anchor = link[3] or ""
        if not path:
            return f'{kind}="#p{own}-{anchor[1:]}"'
        target = posixpath.normpath(posixpath.join(posixpath.dirname(page), path))
        if target in pages:
            return f'{kind}="#p{pages.index(target)}-{anchor[1:]}"'
        return f'{kind}="html/{target}{anchor}"'

    text = re.sub(r'\bid="', f'id="p{own}-', LINK.sub(redirect, text)).replace("url(#", f"url(#p{own}-")
    text = text.replace('loading="lazy"', 'loading="eager"').replace("<details>", "<details open>")
    return f'<article class="bd-article" id="p{own}-">{text}</article>'


def whole(html: Path) -> str:
    """Return the one page, for a file beside the folder of the built book, whose style sheets it uses."""
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
    """Print a local page; Chromium's virtual time lets all figures be drawn first."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise SystemExit(f"no Chromium on this machine (apt-get install chromium); the page is {page.as_uri()}")
    options = ["--headless", "--no-pdf-header-footer", "--virtual-time-budget=60000", "--use-angle=swiftshader"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")
    subprocess.run([browser, *options, f"--print-to-pdf={pdf}", page.as_uri()], check=True, stderr=subprocess.DEVNULL)


if __name__ == "__main__":
    page = BUILD / "paper.html"
    pdf = BUILD / "topokit.pdf"
    page.write_text(whole(BUILD / "html"), encoding="utf-8")
    print_page(page, pdf)
    print(f"The book on paper: {pdf.as_uri()} ({pdf.stat().st_size / 1e6:.0f} MB); as one page: {page.as_uri()}")
