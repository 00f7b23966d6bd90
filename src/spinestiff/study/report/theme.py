"""Figures in a page: SVG that takes its colours from the page's theme, light, dark or printed.

A figure is drawn once, in the colours of paper. In a page each colour is a CSS variable that falls back to itself, and
the page's dark theme sets the variables; so one drawing serves both, and what is printed is as drawn.
"""

from __future__ import annotations

import re

DARK = {
    "#ffffff": "#1b212a",
    "#18202a": "#e8ecf1",
    "#222222": "#e8ecf1",
    "#444444": "#a5b0bd",
    "#6e6e6e": "#a5b0bd",
    "#8a8a8a": "#8f9aa7",
    "#999999": "#7d8794",
    "#a9a9a9": "#77818d",
    "#bbbbbb": "#5a6573",
    "#dddddd": "#3d4855",
    "#e3e3e3": "#343d49",
    "#0072b2": "#6cb8f0",
    "#9cd3f2": "#24506e",
    "#d55e00": "#ff9f56",
    "#1d6b3c": "#7fd6a0",
}
"""Colours of figures on paper, and what takes their place in the dark."""
_COLOUR = re.compile(r"(fill|stroke): (#[0-9a-f]{6})")
_DROPPED = re.compile(r"<\?xml.*?\?>|<!DOCTYPE.*?>|<!--.*?-->|<metadata>.*?</metadata>|<style.*?</style>", re.DOTALL)


def variable(colour: str) -> str:
    """The CSS variable of a colour "#rrggbb"."""
    return f"--f-{colour.removeprefix('#')}"


def dark_style() -> str:
    """Declarations that make figures dark."""
    return " ".join(f"{variable(light)}: {dark};" for light, dark in DARK.items())


def for_page(svg: bytes, name: str) -> str:
    """An SVG of ``figures.as_svg`` as an element of a page.

    Parameters
    ----------
    name : of letters, digits and dashes, the page's only one: what the figure refers to inside itself is named by it.
    """
    text = _DROPPED.sub("", svg.decode("utf-8"))
    text = re.sub(r' (?:xmlns(?::xlink)?|version)="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r'( id="| href="#|url\(#)', rf"\g<1>{name}-", text)
    text = _COLOUR.sub(lambda found: f"{found[1]}: var({variable(found[2])}, {found[2]})", text)
    # Named by the text around it: a reader of the page aloud hears that once.
    return re.sub(r"<svg\b", '<svg class="drawing" aria-hidden="true" focusable="false"', text.strip(), count=1)
