"""Draw the template torso from the front, the side and behind, at true proportions.

python tools/draw_torso.py [--height 157] [--mesh fine] [--out docs/images/torso.png]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from spinestiff.anatomy.template import template_torso
from spinestiff.study.torso_picture import draw_torso


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--height", type=float, default=157.0, help="body height, cm")
    parser.add_argument("--mesh", choices=("coarse", "fine"), default="fine")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent.parent / "docs" / "images" / "torso.png")
    arguments = parser.parse_args()
    draw_torso(template_torso(arguments.height, arguments.mesh), arguments.out)


if __name__ == "__main__":
    main()
