"""How the kernels of the book's build are configured; `conf.py` lays this file where IPython looks for it.

Matplotlib's figures become SVG, with text as text: sharp at any size, and in the colours of the page around them (`conf.py`).
"""

import logging

c = get_config()  # noqa: F821 - IPython hands it over
c.InlineBackend.figure_formats = {"svg"}
c.InlineBackend.print_figure_kwargs = {
    "bbox_inches": "tight",
    "dpi": 144,
}  # for the parts that become pixels, such as cloth
c.InlineBackend.rc = {"svg.fonttype": "none", "svg.hashsalt": "topokit", "font.size": 11, "figure.facecolor": "white"}
# Marks and lines with thousands of points become pixels: as shapes they weigh megabytes and scroll badly.
c.InteractiveShellApp.exec_lines = [
    """
def _pixels():
    import sys
    if "matplotlib.pyplot" in sys.modules:
        from matplotlib import collections, lines, pyplot
        for figure in map(pyplot.figure, pyplot.get_fignums()):
            for artist in figure.findobj(collections.Collection):
                shapes = max(len(artist.get_offsets()), len(artist.get_paths()))
                many = "3D" in type(artist).__name__ or shapes > 1000
                if many and getattr(artist.draw, "_supports_rasterization", False):  # marks in space do not
                    artist.set_rasterized(True)
            for line in figure.findobj(lines.Line2D):
                most = 1000 if line.get_linestyle() == "None" else 3000
                if len(line.get_xdata()) > most:
                    line.set_rasterized(True)
get_ipython().events.register("post_execute", _pixels)
del _pixels
"""
]
c.HistoryManager.enabled = False
c.IPKernelApp.log_level = logging.ERROR  # hide the warning that the kernel listens on TCP
