"""What somebody does on the workbench's page, in a browser's tab."""

from __future__ import annotations

import itertools
import json


def load(tab, address, state="open"):
    tab.loaded = False
    tab.call("Page.navigate", url="about:blank")
    tab.wait(lambda: tab.loaded)
    # What the page before said last comes late.
    tab.settle()
    tab.requests.clear()
    tab.complaints.clear()
    tab.loaded = False
    tab.call("Page.navigate", url=address)
    tab.wait(lambda: tab.loaded)
    tab.until(f"document.body.dataset.state == '{state}'")


def go(tab, place):
    tab.run(f"(document.body.dataset.state = 'asked', location.hash = {json.dumps('#' + place)}, 1)")
    tab.until("document.body.dataset.state == 'open'")


def click(tab, selector):
    tab.until(f"!!document.querySelector({json.dumps(selector)})")
    tab.run(f"(document.querySelector({json.dumps(selector)}).click(), 1)")


def press(tab, selector):
    """As somebody moves the mouse there and presses it: a click that something else would get is none."""
    named = json.dumps(selector)
    tab.until(f"!!document.querySelector({named})")
    tab.run(f"(document.querySelector({named}).scrollIntoView({{ block: 'center' }}), 1)")
    tab.settle()
    at = tab.run(
        f"(e => {{ const b = e.getBoundingClientRect(), at = [b.x + b.width / 2, b.y + b.height / 2];"
        f" return e.contains(document.elementFromPoint(...at)) && !e.disabled ? at : null; }})"
        f"(document.querySelector({named}))"
    )
    assert at, f"{selector} can't be clicked"
    tab.drag(at, at)


def write(tab, selector, text):
    """Click into a field and type, letter by letter."""
    focused = f"document.activeElement == document.querySelector({json.dumps(selector)})"
    press(tab, selector)
    for _ in range(3):
        # An answer of the server may have moved the field from under the pointer.
        if not tab.run(focused):
            press(tab, selector)
    assert tab.run(focused), f"{selector} does not get the focus"
    for letter in text:
        tab.press(letter)


def pick(tab, selector, letters):
    """An entry of a list by its first letters."""
    tab.until(f"!!document.querySelector({json.dumps(selector)})")
    tab.run(f"(document.querySelector({json.dumps(selector)}).focus(), 1)")
    for letter in letters:
        tab.press(letter)


def fill(tab, selector, text):
    """As somebody types: the field in focus, its old text replaced."""
    tab.run(f"(document.querySelector({json.dumps(selector)}).focus(), document.activeElement.select?.(), 1)")
    tab.call("Input.insertText", text=text)


def files(tab, selector, paths):
    top = tab.call("DOM.getDocument")["root"]["nodeId"]
    node = tab.call("DOM.querySelector", nodeId=top, selector=selector)["nodeId"]
    tab.call("DOM.setFileInputFiles", files=[str(path) for path in paths], nodeId=node)


def text(tab, selector="#room"):
    return tab.run(f"document.querySelector({json.dumps(selector)}).innerText")


def chosen(tab, selector, value):
    """As somebody picks an entry of a list."""
    pick = f"e.value = {json.dumps(value)}, e.dispatchEvent(new Event('change')), 1"
    tab.run(f"(e => ({pick}))(document.querySelector({json.dumps(selector)}))")


def box(*sizes):
    """A box as an OBJ file, of these extents along x, y and z."""
    corners = [[size * bit for size, bit in zip(sizes, bits)] for bits in itertools.product((0, 1), repeat=3)]
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    lines = ["v " + " ".join(map(str, corner)) for corner in corners]
    return "\n".join(lines + ["f " + " ".join(str(i + 1) for i in quad) for quad in quads]).encode()
