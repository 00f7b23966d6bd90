"""A small radiograph, a way to change it, and the campaign of damaged files."""

from __future__ import annotations

import importlib.util
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pydicom
import pytest

from spinestiff.imaging.projection import frontal_view
from spinestiff.imaging.radiograph import write_radiographs

VIEW = frontal_view(sid=1500.0, source_to_patient=1340.0, shape=(40, 36), pixel=0.4)


@pytest.fixture(scope="session")
def campaign_module():
    """``benchmarks/damaged_dicom.py``."""
    path = Path(__file__).parents[3] / "benchmarks" / "damaged_dicom.py"
    spec = importlib.util.spec_from_file_location("damaged_dicom", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def file(tmp_path) -> Callable[..., Path]:
    """A file of given pixels, with tags set (None: removed)."""

    def make(pixels: np.ndarray | None = None, name: str = "a.dcm", change=None, **values: object) -> Path:
        pixels = np.arange(40 * 36, dtype=np.uint16).reshape(1, 40, 36) * 40 if pixels is None else pixels
        path = tmp_path / name
        write_radiographs(path, pixels, VIEW, description=name)
        dataset = pydicom.dcmread(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for keyword, value in values.items():
                if value is None:
                    delattr(dataset, keyword)
                else:
                    setattr(dataset, keyword, value)
            if change is not None:
                change(dataset)
            dataset.save_as(path)
        return path

    return make
