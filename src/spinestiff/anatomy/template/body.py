"""A body from age, sex, height, mass and curves: how far each of its sizes is from the reference body's.

Every size is the reference's (``sizes.py``) times the ratio of two predictions by one published rule: for this body and
for the reference. Bones follow the mass that goes with height and age; a given mass changes the skin alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spinestiff.anatomy.template import sizes
from spinestiff.anatomy.template.proportions import Proportions
from spinestiff.anatomy.template.vertebrae import balanced_sacral_slope
from spinestiff.errors import TorsoError

Sex = Literal["female", "male"]

HEIGHT_RANGE_CM = (120.0, 200.0)
AGE_RANGE_YEARS = (8.0, 100.0)
KYPHOSIS_RANGE_DEG = (20.0, 50.0)
LORDOSIS_RANGE_DEG = (35.0, 60.0)
BMI_RANGE = (12.0, 40.0)
ADULT_YEARS = 18.0  # sizes change no more with age

# Body mass index, kg/m2: mean mass over squared mean height, AnthroKids (US survey 1975) at 10 to 15 years, Heinz 2003
# (body measurements of 507 adults) from 18; at 8 years the median of the CDC growth charts 2000.
_BMI_AGES = (8.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, ADULT_YEARS)
_BMI = {
    "female": (15.8, 17.6, 18.3, 18.8, 19.3, 20.1, 20.9, 22.3),
    "male": (15.8, 17.9, 18.1, 18.6, 19.4, 20.3, 21.2, 24.7),
}
# Mean height by age, cm: AnthroKids 10 to 15 years; 8 years CDC 2000; adults Heinz 2003.
_HEIGHTS = {
    "female": (127.5, 141.3, 146.8, 152.8, 156.6, 160.9, 161.5, 164.9),
    "male": (128.0, 140.7, 144.7, 151.5, 157.4, 163.3, 171.8, 177.7),
}


@dataclass(frozen=True)
class Body:
    """Whose torso it is.

    Attributes
    ----------
    height_cm : 120 to 200.
    age_years : 8 to 100; from 18 an adult.
    sex : "female" or "male".
    mass_kg : body mass; its index must lie between 12 and 40 kg/m2.
    kyphosis_deg : T1 to T12, 20 to 50.
    lordosis_deg : L1 to S1, 35 to 60.

    Raises
    ------
    TorsoError : a value out of range.
    """

    height_cm: float
    age_years: float
    sex: Sex
    mass_kg: float
    kyphosis_deg: float = sizes.KYPHOSIS_DEG
    lordosis_deg: float = sizes.LORDOSIS_DEG

    def __post_init__(self) -> None:
        if self.sex not in _BMI:
            raise TorsoError(f"sex '{self.sex}'; wanted female or male")
        for what, value, (low, high), unit in (
            ("body height", self.height_cm, HEIGHT_RANGE_CM, "cm"),
            ("age", self.age_years, AGE_RANGE_YEARS, "years"),
            ("thoracic kyphosis", self.kyphosis_deg, KYPHOSIS_RANGE_DEG, "degrees"),
            ("lumbar lordosis", self.lordosis_deg, LORDOSIS_RANGE_DEG, "degrees"),
        ):
            if not low <= value <= high:
                raise TorsoError(f"{what} {value:g} {unit}; wanted {low:g} to {high:g} {unit}")
        check_mass(self.mass_kg, self.height_cm)


def check_mass(mass_kg: float, height_cm: float) -> None:
    """Raise TorsoError for a body mass, kg, that nobody of this height has."""
    index, (low, high) = mass_kg / (0.01 * height_cm) ** 2, BMI_RANGE
    if not low <= index <= high:
        lightest, heaviest = (b * (0.01 * height_cm) ** 2 for b in BMI_RANGE)
        raise TorsoError(
            f"body mass {mass_kg:g} kg at {height_cm:g} cm is {index:.3g} kg/m2; wanted {low:g} to {high:g} kg/m2, "
            f"here {lightest:.0f} to {heaviest:.0f} kg"
        )


def usual_mass(height_cm: float, age_years: float, sex: Sex) -> float:
    """Mean mass, kg, at a height: the mean body mass index of the age."""
    return float(np.interp(age_years, _BMI_AGES, _BMI[sex])) * (0.01 * height_cm) ** 2


def usual_age(height_cm: float, sex: Sex) -> float:
    """The age, years, whose mean height this is; 18 (adult) for all greater heights."""
    return float(np.interp(height_cm, _HEIGHTS[sex], _BMI_AGES))


def body_of(
    height_cm: float,
    age_years: float | None = None,
    sex: Sex | None = None,
    mass_kg: float | None = None,
    kyphosis_deg: float | None = None,
    lordosis_deg: float | None = None,
) -> Body:
    """A body whose missing values are the usual ones: female, the age of the height, the mass of age and height,
    kyphosis 38 and lordosis 45 degrees.

    Raises
    ------
    TorsoError : as ``Body``.
    """
    sex = "female" if sex is None else sex
    if sex not in _BMI:
        raise TorsoError(f"sex '{sex}'; wanted female or male")
    age = usual_age(height_cm, sex) if age_years is None else age_years
    return Body(
        height_cm=height_cm,
        age_years=age,
        sex=sex,
        mass_kg=usual_mass(height_cm, age, sex) if mass_kg is None else mass_kg,
        kyphosis_deg=sizes.KYPHOSIS_DEG if kyphosis_deg is None else kyphosis_deg,
        lordosis_deg=sizes.LORDOSIS_DEG if lordosis_deg is None else lordosis_deg,
    )


REFERENCE_BODY = Body(sizes.HEIGHT_CM, 13.0, "female", usual_mass(sizes.HEIGHT_CM, 13.0, "female"))


# Published rules; heights in cm, masses in kg. Those fitted on ages 9.5 to 16 are used outside of them, too.


def sitting_height(body: Body) -> float:
    """mm; AnthroKids, ages 9.5 to 16 (SD 21 mm)."""
    a, b = {"female": (25.7, 5.04), "male": (68.8, 4.70)}[body.sex]
    return a + b * body.height_cm


def _by_age(body: Body, young: tuple[float, float], adult: tuple[float, float]) -> float:
    # A regression on height up to 16 years, the adults' mean in proportion to height from 18.
    share = float(np.clip((body.age_years - 16.0) / (ADULT_YEARS - 16.0), 0.0, 1.0))
    return (1.0 - share) * (young[0] + young[1] * body.height_cm) + share * adult[0] * body.height_cm / adult[1]


def biacromial_breadth(body: Body) -> float:
    """cm; Berkeley growth study, 10 to 16 years (SD 1.4); adults Heinz 2003."""
    if body.sex == "female":
        return _by_age(body, (1.85, 0.2045), (36.5, 164.9))
    return _by_age(body, (-1.63, 0.2283), (41.2, 177.7))


def bi_iliac_breadth(body: Body) -> float:
    """cm; Berkeley growth study, 10 to 16 years (SD 1.4); adults Heinz 2003."""
    if body.sex == "female":
        return _by_age(body, (-7.28, 0.2126), (27.6, 164.9))
    return _by_age(body, (0.97, 0.1518), (28.1, 177.7))


def _power_law(body: Body, mass_kg: float, women: tuple[float, ...], men: tuple[float, ...]) -> float:
    # Boys grow from the women's law at 10 years, where the sexes hardly differ, to the men's at 18.
    share = 0.0 if body.sex == "female" else float(np.clip((body.age_years - 10.0) / (ADULT_YEARS - 10.0), 0.0, 1.0))
    both = [c * body.height_cm**h * mass_kg**w for c, h, w in (women, men)]
    return (1.0 - share) * both[0] + share * both[1]


def chest_breadth(body: Body, mass_kg: float) -> float:
    """cm; power law of Heinz 2003's adults (5 %)."""
    return _power_law(body, mass_kg, (12.56, -0.100, 0.302), (13.73, -0.196, 0.412))


def chest_depth(body: Body, mass_kg: float) -> float:
    """cm; power law of Heinz 2003's adults (7 to 8 %)."""
    return _power_law(body, mass_kg, (39.1, -0.526, 0.461), (4.77, -0.203, 0.579))


def hip_girth(body: Body) -> float:
    """cm; power law of Heinz 2003's adults (3 %)."""
    c, h, w = {"female": (50.9, -0.244, 0.459), "male": (54.8, -0.272, 0.457)}[body.sex]
    return c * body.height_cm**h * body.mass_kg**w


def waist_girth(body: Body) -> float:
    """cm; AnthroKids, ages 9.5 to 16 (SD 3.4)."""
    c, h, w = {"female": (74.0, -0.295, 0.844), "male": (87.0, -0.403, 0.910)}[body.sex]
    return c + h * body.height_cm + w * body.mass_kg


def waist_shape(body: Body) -> float:
    """Breadth over depth of the waist (ANSUR II)."""
    return {"female": 1.41, "male": 1.37}[body.sex]


def proportions(body: Body) -> Proportions:
    """The sizes of a body over the reference's."""
    other = REFERENCE_BODY
    usual, others = usual_mass(body.height_cm, body.age_years, body.sex), other.mass_kg
    breadth, depth = (rule(body, body.mass_kg) / rule(other, others) for rule in (chest_breadth, chest_depth))
    waist = waist_girth(body) / waist_girth(other)
    flat = waist_shape(body) / waist_shape(other)
    hips = hip_girth(body) / hip_girth(other)
    return Proportions(
        height_cm=body.height_cm,
        spine=sitting_height(body) / sitting_height(other),
        thorax=(chest_breadth(body, usual) / chest_breadth(other, others),
                chest_depth(body, usual) / chest_depth(other, others)),
        shoulder=biacromial_breadth(body) / biacromial_breadth(other),
        pelvis=bi_iliac_breadth(body) / bi_iliac_breadth(other),
        chest=(breadth, depth),
        # The girth is kept: of an ellipse it goes about with the mean of breadth and depth.
        waist=(waist * 2.41 * flat / (1.41 * flat + 1.0), waist * 2.41 / (1.41 * flat + 1.0)),
        hips=(hips, hips),
        neck=(breadth, breadth),
        kyphosis_deg=body.kyphosis_deg,
        lordosis_deg=body.lordosis_deg,
        sacral_slope_deg=balanced_sacral_slope(body.kyphosis_deg, body.lordosis_deg),
    )  # fmt: skip
