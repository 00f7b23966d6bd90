"""Store the shipped model's numbers that `spinestiff check` compares as kind "gold", and print what changed.

    python tools/rewrite_gold.py

Run it after a change that is meant to change them (mesh, element, default stiffness), once every independent check
passes: a stored number shows change, not error.
"""

from __future__ import annotations

import datetime
import json
import sys
from pathlib import Path

from spinestiff import __version__
from spinestiff.verification import whole
from spinestiff.verification.checks import GROUPS, run_checks

FILE = Path(whole.__file__).with_name(whole.GOLD_FILE)


def main() -> int:
    """Write the file; 1 and nothing written where an independent check fails."""
    independent = run_checks(groups=tuple(group for group in GROUPS if group is not whole.gold))
    failed = [check.name for check in independent if not check.passed]
    if failed:
        print("not written; these independent checks fail:", *failed, sep="\n  ")
        return 1
    old = json.loads(FILE.read_text(encoding="utf-8"))["values"] if FILE.exists() else {}
    new = {name: float(f"{value:.12g}") for name, value in whole.gold_values().items()}
    for name in sorted(old.keys() | new.keys()):
        if old.get(name) != new.get(name):
            print(f"{name}: {old.get(name)} -> {new.get(name)}")
    record = {"written": f"{datetime.date.today():%Y-%m-%d}", "version": __version__, "values": new}
    FILE.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
