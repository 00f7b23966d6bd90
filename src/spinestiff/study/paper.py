"""Tables 2 to 7 of the paper (Koutras et al. 2025) as printed, a column a subject."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Sex = Literal["female", "male"]
CURVES = ("thoracic", "thoracolumbar", "lumbar")


@dataclass(frozen=True)
class PaperSubject:
    """A column of Tables 2 and 4.

    Attributes
    ----------
    age : years. cobb_deg : at rest, above 0 convex to the left. change_deg : the largest change of it.
    force_n : the largest, above 0 towards left curvature, which is a push from the right.
    bending, tissue : ratios of the default.
    """

    age: float
    sex: Sex
    height_cm: float
    cobb_deg: float
    curve: str
    change_deg: float
    force_n: float
    bending: float
    tissue: float


SUBJECTS = (
    PaperSubject(11, "female", 157, 11, "thoracic", -19, -59, 0.10, 0.01),
    PaperSubject(15, "female", 160, 16, "lumbar", 13, 114, 0.19, 0.02),
    PaperSubject(10, "male", 144, 15, "thoracic", -46, -60, 0.02, 0.02),
    PaperSubject(12, "female", 146, -10, "thoracic", 25, 79, 0.05, 0.09),
    PaperSubject(15, "female", 168, 16, "lumbar", 8, 88, 0.01, 0.11),
    PaperSubject(10, "male", 139, 11, "thoracolumbar", -26, -45, 0.06, 0.02),
    PaperSubject(14, "male", 165, 7, "thoracic", -20, -92, 0.63, 0.15),
)
Row = tuple[float, ...]
TABLE_3: Mapping[str, Row] = {
    "lateral_shear": (110.5, 85.8, 113.8, 143.4, 10.6, 60.3, 21.0),
    "flexion_extension": (-4.8, -44.9, -4.0, -3.1, -1.8, 0.1, -4.4),
    "axial_rotation": (66.0, 207.6, 114.8, 185.6, 10.4, 41.1, 14.9),
    "intervertebral_bending": (1155.5, 447.4, 594.5, 795.2, 56.8, 468.1, 142.5),
    "tissue_mu": (1821.1, 688.4, 695.3, 1485.1, 134.0, 598.1, 159.7),
    "tissue_lambda": (342.9, -152.3, 25.7, 305.2, 4.6, 72.2, -8.9),
}
"""Gradients of the objective."""
TABLE_5: Mapping[str, Row] = {
    "Initial pose": (1.55, 3.87, 2.09, 2.56, 2.99, 2.13, 1.56),
    "Training poses, default params": (15.08, 10.88, 14.27, 11.67, 4.62, 9.68, 3.37),
    "Training poses, optimized params": (3.54, 4.53, 4.12, 3.87, 2.95, 1.95, 2.45),
    "Validation pose, default params": (15.05, 10.87, 14.36, 11.72, 4.39, 8.98, 3.37),
    "Validation pose, optimized params": (3.29, 4.43, 4.13, 3.99, 3.00, 1.93, 2.37),
}
"""RMSE, mm."""
TABLE_6: Mapping[str, Row] = {
    "Initial pose": (11, 16, 15, -10, 16, 11, 7),
    "Diff in validation pose (measured)": (-16, 6, -43, 26, 0, -27, -15),
    "Diff in validation pose (default params)": (0, -1, -8, 16, -1, -3, -14),
    "Diff in validation pose (optimized params)": (-17, 4, -38, 30, 2, -25, -19),
}
"""Cobb angle, degrees."""
TABLE_7: Mapping[str, Row] = {
    "intervertebral_bending": (10.4, 7.9, 18.8, 0.0, 0.0, 13.8, 2.4),
    "tissue_mu": (25.0, 44.4, 14.7, 27.8, 18.2, 40.0, 30.0),
}
"""Percent of the estimate for 10 % of force."""
