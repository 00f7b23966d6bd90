"""What somebody's fingers do on a page in a browser's tab, its window that of a tablet."""

from __future__ import annotations

import json
from contextlib import contextmanager


@contextmanager
def screen(tab, width, height, ratio=1, finger=False):
    """The window of a screen; with ``finger`` one that is touched."""
    try:
        tab.call("Emulation.setTouchEmulationEnabled", enabled=finger, maxTouchPoints=5)
        given = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": finger}
        tab.call("Emulation.setDeviceMetricsOverride", **given)
        yield
    finally:
        tab.call("Emulation.setTouchEmulationEnabled", enabled=False)
        tab.size(1280, 800)


def touch(tab, kind, *places):
    """Fingers down ("Start"), moved ("Move") or up ("End")."""
    points = [{"x": x, "y": y, "id": i, "radiusX": 10, "radiusY": 10} for i, (x, y) in enumerate(places)]
    tab.call("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=points)


def tap_at(tab, place):
    touch(tab, "Start", place)
    touch(tab, "End")


def tap(tab, selector):
    """Tap the middle of a control, which has to be there."""
    named = json.dumps(selector)
    tab.until(f"(e => e?.getClientRects().length && !e.disabled)(document.querySelector({named}))")
    tab.run(f"(document.querySelector({named}).scrollIntoView({{block: 'nearest'}}), 1)")
    tab.settle()
    at = tab.run(
        f"(() => {{ const e = document.querySelector({named}), box = e.getClientRects()[0];"
        " const at = [box.x + box.width / 2, box.y + box.height / 2], over = document.elementFromPoint(...at);"
        " return e.contains(over) || over?.closest('label')?.contains(e) ? at : null; })()"
    )
    assert at, f"{selector} can't be tapped"
    tap_at(tab, at)


def pinch(tab, middle, apart, steps=6):
    """Two fingers from ``apart[0]`` to ``apart[1]`` pixels from each other."""
    x, y = middle

    def both(distance):
        return (x - 0.5 * distance, y), (x + 0.5 * distance, y)

    touch(tab, "Start", both(apart[0])[0])
    for step in range(steps + 1):
        touch(tab, "Move" if step else "Start", *both(apart[0] + (apart[1] - apart[0]) * step / steps))
    touch(tab, "End")
