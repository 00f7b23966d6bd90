"""Exports read once each."""

from __future__ import annotations

import pytest

from hospital import export
from spinestiff.imaging.dicom.export import read_exported


@pytest.fixture
def exported(tmp_path):
    """A radiograph written and read: the keywords of ``hospital.export``."""

    def make(name="a", *args, **kwargs):
        return read_exported(export(tmp_path / "export" / name, *args, **kwargs), name, tmp_path / "export")

    return make
