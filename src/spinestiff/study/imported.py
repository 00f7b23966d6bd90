"""What an import leaves behind: the torso, a summary, and a picture to look at; all of it or nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spinestiff.anatomy.files import write_torso
from spinestiff.anatomy.importing import ImportedTorso
from spinestiff.anatomy.torso import TorsoModel
from spinestiff.errors import TorsoError
from spinestiff.files import whole_folder, write_json

SCHEMA_VERSION = 1


def write_imported(found: ImportedTorso, folder: Path) -> None:
    """Write ``torso.npz``, ``torso.json`` and ``torso.png`` into a new or empty folder.

    Raises
    ------
    TorsoError : the folder holds something, or can't be written; then nothing is left there.
    """
    from spinestiff.anatomy.picture import draw_torso

    with whole_folder(folder, TorsoError) as draft:
        write_torso(draft / "torso.npz", found.torso)
        write_json(draft / "torso.json", import_record(found))
        draw_torso(found.torso, draft / "torso.png")


def import_record(found: ImportedTorso) -> dict[str, Any]:
    """The summary as JSON: files, unit, axes, repairs, notes, facts."""
    return {
        "schema_version": SCHEMA_VERSION,
        "unit": found.placement.unit,
        "axes": found.placement.axes,
        "told": list(found.placement.told),
        "height_cm": round(found.torso.height_cm, 1),
        "bones": {bone: [path.name for path in paths] for bone, paths in found.files.bones.items()},
        "skin": found.files.skin.name if found.files.skin else None,
        "ignored": list(found.files.ignored),
        "repairs": list(found.repairs),
        "notes": list(found.notes),
        "mesher": found.tissue.mesher,
        "least_dihedral_deg": round(found.tissue.least_angle_deg, 2),
        "mesh_over_skin_volume": round(found.tissue.volume_share, 4),
        "facts": torso_facts(found.torso),
    }


def torso_facts(torso: TorsoModel) -> dict[str, str]:
    """A torso in a few figures, in words."""
    tissue = torso.tissue
    tied = np.bincount(tissue.bone_of_node[tissue.bone_of_node >= 0], minlength=len(torso.bone_names))
    volume = float(tissue.corner_volumes().sum())
    facts = {
        "bones": str(len(torso.bone_names)),
        "joints": str(len(torso.joints)),
        "nodes": f"{len(tissue.rest_positions)} ({len(tissue.free_nodes)} free, {int(tied.sum())} in bones)",
        "elements": str(len(tissue.elements)),
        "tissue": f"{volume * 1e-6:.1f} l",
        "height": f"{torso.height_cm:.0f} cm",
    }
    if len(tied):
        few = int(np.argmin(tied))
        facts["fewest nodes in a bone"] = f"{int(tied[few])} ({torso.bone_names[few]})"
    return facts
