"""Configure Sphinx: the source directory is the repository, so that chapters and prose can refer to each other.

    python -m sphinx -n -W --keep-going -b html -c book -d _build/doctrees . _build/html

One process reads all pages (no `-j`), since sphinx-proof cannot merge the pages of several.
Nothing is fetched: KaTeX is in `_static`, and the interactive figures contain their scripts.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "book"), str(ROOT / "notebooks")]

from docutils import nodes  # noqa: E402
from jupyter_cache import get_cache  # noqa: E402

import topokit  # noqa: E402

# ---- what the book is

project = "topokit"
author = "The topokit authors"
copyright = f"2026, {author}"
version = release = topokit.__version__

# ---- what it is made of

root_doc = "book/index"
include_patterns = ["book/**", "notebooks/**"]
exclude_patterns = ["**/_build/**", "**/.ipynb_checkpoints/**"]
extensions = [
    "myst_nb",
    "shell",
    "cards",
    "clouds",
    "links",
    "moved",
    "teach",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_exercise",
    "sphinx_proof",
    "sphinxcontrib.bibtex",
]
myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath", "smartquotes"]
myst_heading_anchors = 3
numfig = True
# Theorems, definitions and remarks share one count, so that a number finds its place; exercises have their own.
proof_minimal_theme = True
prf_realtyp_to_countertyp = {
    kind: "theorem" for kind in ("corollary", "definition", "example", "lemma", "remark", "proposition")
}
bibtex_bibfiles = ["references.bib"]
bibtex_reference_style = "author_year"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True  # as they are written: the value of one may hold a path of this machine
napoleon_google_docstring = False
napoleon_use_param = napoleon_use_rtype = False  # shapes such as "(n, 3) float" are no classes to link to
napoleon_custom_sections = [("Attributes", "params_style")]
nitpick_ignore_regex = [("py:(class|exc)", r"(?!topokit\.).*")]  # nor are "array_like" and errors named in prose

# The public repository, which Binder and Colab copy; where it is empty, no chapter links to them.
chapters_repository = "https://github.com/topokit/topokit"

# ---- how chapters run


def _digest() -> str:
    """Return a digest of all that a chapter's outputs depend on: its text, the library, the data and the environment.

    myst-nb's cache compares the notebook alone. The cache is in a folder with this name, so any other change makes a new
    cache, and no output on a page can be older than its cause.
    """
    hashed = hashlib.sha256()
    files = [ROOT / "requirements.txt", ROOT / "book" / "kernel.py"]
    for folder, pattern in (
        ("topokit", "**/*"),
        ("data_small", "**/*"),
        ("book/results", "**/*"),
        ("book/experiments", "**/*"),
        ("notebooks", "*.ipynb"),
        ("notebooks/chapter_tools", "**/*"),
    ):
        files += [path for path in (ROOT / folder).glob(pattern) if "__pycache__" not in path.parts]
    for path in sorted(path for path in files if path.is_file()):
        hashed.update(f"{path.relative_to(ROOT)}\0{path.stat().st_size}\0".encode())
        hashed.update(path.read_bytes())
    packages = sorted({(d.metadata["Name"], d.version) for d in metadata.distributions()}, key=str)
    switches = sorted((name, value) for name, value in os.environ.items() if name.startswith("TOPOKIT_"))
    hashed.update(repr((sys.version, packages, switches)).encode())
    return hashed.hexdigest()[:16]


def _kernels() -> None:
    """Configure the kernels that run the chapters by kernel.py and by nothing else on this machine."""
    profile = ROOT / "_build" / "ipython" / "profile_default"
    profile.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(ROOT / "book" / "kernel.py", profile / "ipython_kernel_config.py")
    os.environ["IPYTHONDIR"] = str(profile.parent)


def _fresh_cache() -> str:
    """Remove caches of other digests, and return the folder of the cache for the present one."""
    caches = ROOT / "_build" / "jupyter_cache"
    digest = _digest()
    for old in caches.glob("*"):
        if old.is_dir() and old.name != digest:
            shutil.rmtree(old)
    cache = get_cache(caches / digest)
    cache.list_cache_records()  # make the database now, before processes that run side by side all try to
    return str(caches / digest)


_kernels()
nb_execution_mode = "cache"
nb_execution_cache_path = _fresh_cache()
nb_execution_raise_on_error = True
nb_execution_in_temp = False  # chapters read ../data_small
nb_execution_timeout = 300
nb_execution_show_tb = True
nb_merge_streams = True
nb_render_markdown_format = "gfm"  # of outputs: CommonMark has no tables
nb_code_prompt_show, nb_code_prompt_hide = "Show the code", "Hide the code"

# ---- how it looks

html_theme = "sphinx_book_theme"
html_static_path = ["_static"]
html_css_files = ["katex/katex.min.css", "topokit.css"]
html_js_files = ["book.js", "slides.js"]
html_copy_source = False
html_show_sourcelink = False
html_last_updated_fmt = None
html_theme_options: dict[str, Any] = {
    "home_page_in_toc": False,
    "show_toc_level": 2,
    "use_download_button": False,
    "use_fullscreen_button": False,
    "navbar_persistent": [],  # the theme would show its search field twice
    "navbar_end": [],
    "logo": {"text": "topokit"},
}
html_favicon = html_logo = "_static/logo.svg"
html_title = "topokit"
html_context = {"default_mode": "auto"}
mathjax_path = (
    "katex/katex.min.js"  # Sphinx writes formulas for MathJax; book.js hands them to KaTeX, a tenth of its size
)
myst_update_mathjax = False


def _property(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Keep napoleon from reading a property's first line, "what it is: how", as "type: description"."""
    if what == "property":
        lines.insert(0, "")


def _hover(app: Any, doctree: Any, docname: str) -> None:
    """Give each term the first paragraph of its glossary entry as a title, which browsers show under the pointer."""
    entries = app.env.get_doctree("book/glossary").findall(nodes.definition_list_item)
    meanings = {name: entry[-1][0].astext() for entry in entries for term in entry[:-1] for name in term["ids"]}
    for reference in doctree.findall(nodes.reference):
        children = [child for child in reference.children if isinstance(child, nodes.Element)]
        if any("std-term" in child.get("classes", ()) for child in children):
            term = reference.get("refid") or reference["refuri"].rpartition("#")[2]
            reference["reftitle"] = meanings[term]


def setup(app: Any) -> dict[str, bool]:
    # As a value that Sphinx remembers, the digest also makes it read every page again when it changes.
    app.add_config_value("chapters_digest", Path(nb_execution_cache_path).name, "env")
    app.connect("doctree-resolved", _hover)
    app.connect("autodoc-process-docstring", _property, priority=400)  # before napoleon's 500
    return {"parallel_read_safe": True, "parallel_write_safe": True}
