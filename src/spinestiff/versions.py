"""What is installed: libraries, and what each extra is for."""

from __future__ import annotations

import importlib.metadata
from dataclasses import dataclass

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "rslab",
    "pydantic",
    "pydicom",
    "pylibjpeg-openjpeg",
    "pyjpegls",
    "pillow",
    "opencv-python-headless",
    "scikit-image",
    "matplotlib",
)


@dataclass(frozen=True)
class Extra:
    """An extra of the package: ``pip install "spinestiff[name]"``.

    Attributes
    ----------
    libraries : that it installs, as packages are called. use : what works with it alone.
    """

    name: str
    libraries: tuple[str, ...]
    use: str

    @property
    def missing(self) -> tuple[str, ...]:
        """Those of its libraries that are not installed."""
        return tuple(name for name in self.libraries if installed(name) is None)


EXTRAS = (
    Extra("dicom", ("python-gdcm",), "JPEG Lossless radiographs"),
    Extra("mesh", ("mmgpy",), "spinestiff torso import, synth --nodes: tissue meshes of one's own"),
    Extra("febio", ("pyfebio",), "spinestiff torso export --format feb"),
    Extra("torch", ("torch",), "the equilibrium in PyTorch's automatic differentiation"),
    Extra("jax", ("jax",), "the equilibrium in JAX's automatic differentiation"),
    Extra(
        "docs",
        ("sphinx", "furo", "myst-nb", "sphinx-copybutton", "latex2mathml", "ziamath"),
        "the documentation site",
    ),
    Extra("cluster", ("distributed", "dask-jobqueue"), "spinestiff cohort --scheduler: a Dask cluster"),
    Extra("gpu", ("nvmath-python",), "SPINESTIFF_SOLVER=cudss: factorisations on an NVIDIA GPU (Linux)"),
    Extra("oracles", ("opensim", "mujoco", "felupe", "scikit-fem"), "programs that tests compare answers with"),
    Extra(
        "test", ("pytest", "pytest-xdist", "hypothesis", "mpmath", "ruff", "mypy", "hatchling"), "tests, lint and types"
    ),
)
"""Every extra of pyproject.toml."""


def installed(name: str) -> str | None:
    """The version of a package; None: not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
