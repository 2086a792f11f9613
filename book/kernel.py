"""How the kernels of the book's build are configured; `conf.py` lays this file where IPython looks for it.

Matplotlib's figures become SVG, with text as text: sharp at any size, and in the colours of the page around them (`conf.py`).
"""

import logging

c = get_config()  # noqa: F821 - IPython hands it over
c.InlineBackend.figure_formats = {"svg"}
c.InlineBackend.print_figure_kwargs = {
    "bbox_inches": "tight",
    "dpi": 144,
}  # of the parts that stay pixels, such as cloth
c.InlineBackend.rc = {"svg.fonttype": "none", "svg.hashsalt": "topokit", "font.size": 11, "figure.facecolor": "white"}
# Marks and pieces of lines that are many stay pixels too: thousands of shapes weigh megabytes and scroll badly.
c.InteractiveShellApp.exec_lines = [
    """
def _pixels():
    import sys
    if "matplotlib.pyplot" in sys.modules:
        from matplotlib import collections, lines, pyplot
        for figure in map(pyplot.figure, pyplot.get_fignums()):
            able = lambda artist: getattr(artist.draw, "_supports_rasterization", False)  # marks in space are not
            for artist in filter(able, figure.findobj(collections.Collection)):
                if "3D" in type(artist).__name__ or max(len(artist.get_offsets()), len(artist.get_paths())) > 1000:
                    artist.set_rasterized(True)
            for artist in figure.findobj(lines.Line2D):
                if len(artist.get_xdata()) > (1000 if artist.get_linestyle() == "None" else 3000):
                    artist.set_rasterized(True)
get_ipython().events.register("post_execute", _pixels)
del _pixels
"""
]
c.HistoryManager.enabled = False
c.IPKernelApp.log_level = logging.ERROR  # else every kernel says that it speaks over TCP, with this machine alone
