"""What the workbench's routes work on: the served folder, its jobs, uploads, trash and tickets."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from spinestiff.errors import InUseError
from spinestiff.workbench.jobs import Jobs
from spinestiff.workbench.newcomer import Sources
from spinestiff.workbench.parcel import Parcels
from spinestiff.workbench.results import Tickets
from spinestiff.workbench.rooms import Root, open_root
from spinestiff.workbench.trash import Trash
from spinestiff.workbench.uploads import Uploads


@dataclass(frozen=True)
class Bench:
    """A served folder with all that belongs to it."""

    root: Root
    jobs: Jobs
    uploads: Uploads
    sources: Sources
    trash: Trash
    tickets: Tickets
    parcels: Parcels
    read_only: bool = False

    def refuse_busy(self, key: str) -> None:
        """Raise InUseError where a subject has a job that has not ended."""
        if self.jobs.table.active(key) is not None:
            raise InUseError("this subject has a job; cancel it first, or wait for its end")


def open_bench(
    path: Path,
    sources: tuple[Path, ...] = (),
    upload_bytes: int = 8 * 2**30,
    side_by_side: int = 1,
    read_only: bool = False,
) -> Bench:
    """Open a folder to be served.

    Parameters
    ----------
    sources : folders on this machine that subjects may be made from.
    upload_bytes : of one upload at most. side_by_side : jobs at once.

    Raises
    ------
    SubjectError : see ``open_root``.
    """
    root = open_root(path, read_only)
    bench = Bench(
        root,
        Jobs(root, side_by_side),
        Uploads(root, upload_bytes),
        Sources(root, tuple(one.resolve() for one in sources)),
        Trash(root),
        Tickets(),
        Parcels(root.own / "parcels"),
        read_only,
    )
    if not read_only:
        bench.parcels.clear()
        bench.uploads.clear()
        bench.jobs.table.make()
    return bench
