"""What all pictures share: colours, style, ticks, and figures as bytes.

Every picture's function returns a Matplotlib figure that belongs to no window; ``as_png`` and ``as_svg`` turn it
into bytes that are the same for the same figure. Colours (Okabe and Ito's, told apart with any colour vision) mean
the same everywhere: blue is measured, orange is the fit, grey is the default. Marks and line styles differ too.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK = "#18202A"
MEASURED, FIT, DEFAULT, TRUTH = "#0072B2", "#D55E00", "#6E6E6E", INK
# The same hues, lighter, over the dark of a radiograph.
MEASURED_ON_DARK, SIMULATED_ON_DARK, WHITE_ON_DARK = "#56C1FF", "#FFA530", "#FEFEFE"
PNG_DPI = 130
PERCENTILES = (1.0, 99.7)  # of the crop's grey values, black to white
LABEL_GAP = 0.04  # inches between tick labels
# What would say when, and with which version of Matplotlib, a file was made.
_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
}
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "legend.frameon": False,
    # Names of files and folders may have dollars, which would begin a formula.
    "text.parse_math": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "spinestiff",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


def as_png(figure: Figure) -> bytes:
    """The figure as PNG; its layout stays as it is then."""
    return _saved(figure, ("png",))[0]


def as_svg(figure: Figure) -> bytes:
    """The figure as SVG, letters as outlines, without a date; its layout stays as it is then."""
    return _saved(figure, ("svg",))[0]


def as_png_and_svg(figure: Figure) -> tuple[bytes, bytes]:
    """The figure as ``as_png`` and as ``as_svg`` has it, laid out once."""
    png, svg = _saved(figure, ("png", "svg"))
    return png, svg


def _saved(figure: Figure, kinds: Sequence[str]) -> list[bytes]:
    found = []
    with rc_context(STYLE):
        part_tick_labels(figure)
        for kind in kinds:
            stream = BytesIO()
            figure.savefig(stream, format=kind, dpi=PNG_DPI, metadata=_METADATA[kind])
            found.append(stream.getvalue())
    return found


def part_tick_labels(figure: Figure) -> None:
    """Hide each number of an axis that would touch the one before it; the tick itself stays, and so does the layout.

    Names, which stand for something of their own each, all stay.
    """
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # what was worked out just now holds for what follows
    for axes in figure.axes:
        for side, along in ((axes.xaxis, 0), (axes.yaxis, 1)):
            if isinstance(side.get_major_locator(), FixedLocator) and isinstance(
                side.get_major_formatter(), FuncFormatter
            ):
                continue  # so ``set_xticks`` and ``set_yticks`` keep names
            last = -np.inf
            labels = [tick.label1 for tick in side.get_major_ticks() if tick.label1.get_text()]
            boxes = [(label, label.get_window_extent()) for label in labels if label.get_visible()]
            for label, box in sorted(boxes, key=lambda found: found[1].min[along]):
                touches = box.min[along] < last + LABEL_GAP * figure.dpi
                label.set_visible(not touches)
                last = last if touches else box.max[along]


# Marks within a decade, for axes up to so many decades.
_TICKS = (
    (0.12, tuple(np.arange(1.0, 10.0, 0.2))),
    (0.3, tuple(np.arange(1.0, 10.0, 0.5))),
    (0.7, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)),
    (2.0, (1.0, 2.0, 5.0)),
    (np.inf, (1.0,)),
)


def plain_ticks(axis: Axes, which: str) -> None:
    """Plain numbers, as many as have room, along a logarithmic axis "x" or "y" whose limits are set."""
    side, limits = (axis.xaxis, axis.get_xlim()) if which == "x" else (axis.yaxis, axis.get_ylim())
    decades = float(np.log10(limits[1] / limits[0]))
    subs = next(marks for widest, marks in _TICKS if decades <= widest)
    side.set_major_locator(LogLocator(subs=subs, numticks=8))
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    side.set_minor_formatter(NullFormatter())
