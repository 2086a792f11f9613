"""How the kernels of the book's build are configured; `conf.py` lays this file where IPython looks for it.

Matplotlib's figures become SVG, with text as text: sharp at any size, and in the colours of the page around them (`conf.py`).
"""

import logging

c = get_config()  # noqa: F821 - IPython hands it over
c.InlineBackend.figure_formats = {"svg"}
c.InlineBackend.print_figure_kwargs = {"bbox_inches": "tight", "dpi": 144}  # of the parts that stay pixels, such as cloth
c.InlineBackend.rc = {"svg.fonttype": "none", "svg.hashsalt": "topokit", "font.size": 11, "figure.facecolor": "white"}
c.HistoryManager.enabled = False
c.IPKernelApp.log_level = logging.ERROR  # else every kernel says that it speaks over TCP, with this machine alone
