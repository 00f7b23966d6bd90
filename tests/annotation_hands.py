"""What somebody's mouse does on the annotation page, in a browser's tab."""

from __future__ import annotations

import numpy as np


class Hands:
    """Clicks and drags at pixels of the radiograph in sight."""

    def __init__(self, tab):
        self.tab = tab

    def place(self, pixel):
        """Where a pixel of the radiograph lies in the window."""
        x, y = (float(value) for value in pixel)
        return self.tab.run(
            "(() => { const b = annotation.stage.canvas.getBoundingClientRect();"
            f"const p = annotation.stage.toPlace([{x}, {y}]); return [p[0] + b.left, p[1] + b.top]; }})()"
        )

    def click(self, pixel):
        at = self.place(pixel)
        self.tab.drag(at, at)

    def drag(self, start, end):
        self.tab.drag(self.place(start), self.place(end))

    def marks(self, image="rest/frontal"):
        return self.tab.run(f"annotation.allMarks['{image}'] ?? null")

    def quad(self, name, image="rest/frontal"):
        return np.array(self.marks(image)["vertebrae"][name])

    def saved(self):
        self.tab.until("document.getElementById('saved').innerText.startsWith('Saved')")
