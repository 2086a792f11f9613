"""Tools beside the chapters: the reader's questions, figures, and small studies that no user of topokit needs.

A notebook runs in its own folder, so that it finds this package: ``from chapter_tools import ask``.
"""

from .quiz import ask

__all__ = ["ask"]
