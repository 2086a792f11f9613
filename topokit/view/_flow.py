"""The data-flow picture that opens every chapter, with the chapter's stages lit."""

from __future__ import annotations

from dataclasses import dataclass, field

from topokit.view._palette import OKABE_ITO

# name of the stage -> what leaves it, in the words of the chapters
STAGES = {
    "cloth": "vertices",
    "cloud": "points",
    "loops": "birth, death, killers",
    "tracks": "identities",
    "mixture": "where",
    "model": "what comes next",
    "plan": "what to do",
}
_WIDTH, _HEIGHT, _GAP = 92, 46, 24


@dataclass(frozen=True)
class DataFlow:
    """The picture; a notebook shows it, in the colours of the page around it."""

    svg: str = field(repr=False)  #: as SVG text

    def _repr_html_(self) -> str:
        return f'<div class="topokit-flow">{self.svg}</div>'


def data_flow(*lit: str) -> DataFlow:
    """Return the picture of the stages from cloth to plan, with the stages named in `lit` filled.

    Raises
    ------
    ValueError
        When a name is no stage.
    """
    unknown = [name for name in lit if name not in STAGES]
    if unknown:
        raise ValueError(f"no stage {unknown[0]!r}; there are {', '.join(STAGES)}")
    parts = [_stage(column, name, name in lit) for column, name in enumerate(STAGES)]
    width = len(STAGES) * (_WIDTH + _GAP) - _GAP + 4
    label = f"From cloth to plan in seven stages; this chapter is about {', '.join(lit) or 'none of them'}."
    return DataFlow(
        f'<svg viewBox="0 0 {width} {_HEIGHT + 30}" role="img" aria-label="{label}" '
        'style="width:100%;max-width:820px;height:auto;display:block" font-family="system-ui,sans-serif" '
        f'fill="currentColor" text-anchor="middle">{"".join(parts)}</svg>'
    )


def _stage(column: int, name: str, lit: bool) -> str:
    """One box with its name, what leaves it beneath, and the arrow that leads to it."""
    x, middle = 2 + column * (_WIDTH + _GAP), 2 + _HEIGHT / 2
    fill = (
        f'fill="{OKABE_ITO[1]}" stroke="{OKABE_ITO[1]}"' if lit else 'fill="none" stroke="currentColor" opacity="0.55"'
    )
    ink = 'fill="#ffffff" font-weight="600"' if lit else 'opacity="0.75"'
    arrow = f"M{x - _GAP + 3} {middle}H{x - 7}m-5 -4l5 4l-5 4"
    return (
        (f'<path d="{arrow}" fill="none" stroke="currentColor" opacity="0.6"/>' if column else "")
        + f'<rect x="{x}" y="2" width="{_WIDTH}" height="{_HEIGHT}" rx="7" {fill}/>'
        + f'<text x="{x + _WIDTH / 2}" y="{middle + 5}" font-size="15" {ink}>{name}</text>'
        + f'<text x="{x + _WIDTH / 2}" y="{_HEIGHT + 20}" font-size="11" opacity="0.8">{STAGES[name]}</text>'
    )
