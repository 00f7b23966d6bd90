"""Published sizes of the reference body, a girl of 12 to 13 years and 157 cm.

Adult tables are scaled to her; each constant names its source. Values marked "design" are ours, chosen between the
published ones so that the pieces fit together. mm and degrees.
"""

from __future__ import annotations

import numpy as np

from spinestiff.anatomy.names import VERTEBRAE

HEIGHT_CM = 157.0  # AnthroKids (US survey 1975): girls of 13 years, 156.6 +- 7.0 cm

# T1-T12 and L1-L5 lengths, each from the first upper to the last lower endplate: 0.30 and 0.18 of the sitting height
# (Dimeglio), AnthroKids girls of 13, 813 mm. T1-S1 comes out at 407 mm; his 0.49 would give 398.
THORACIC_LENGTH, LUMBAR_LENGTH = 244.0, 146.0

# Adult vertebrae, means of Panjabi et al. 1991 and 1992: endplate width and depth (upper, lower), posterior height;
# last column, height of the disc below, is design (sums agree with Dimeglio's adult spine lengths).
_ADULT = np.array(
    [
        (24.5, 18.5, 27.8, 19.7, 14.1, 4.5),
        (24.9, 19.6, 27.4, 21.6, 15.6, 4.0),
        (24.6, 22.7, 25.9, 23.3, 15.7, 3.8),
        (24.5, 23.3, 26.0, 24.5, 16.2, 3.8),
        (24.9, 24.3, 27.0, 25.8, 16.2, 4.0),
        (26.2, 26.0, 28.2, 26.9, 17.4, 4.3),
        (27.8, 27.4, 29.1, 28.5, 18.2, 4.6),
        (29.5, 27.9, 30.5, 29.4, 18.7, 4.9),
        (30.6, 29.3, 33.0, 31.0, 19.3, 5.3),
        (31.9, 30.5, 35.4, 31.6, 20.2, 6.0),
        (34.9, 31.9, 39.1, 31.8, 21.3, 6.8),
        (39.0, 32.8, 42.1, 33.4, 22.7, 7.5),
        (41.2, 34.1, 43.3, 35.3, 23.8, 8.4),
        (42.6, 34.6, 45.5, 34.9, 24.3, 9.5),
        (44.1, 35.2, 48.0, 34.8, 23.8, 10.5),
        (46.6, 35.5, 49.5, 33.9, 24.1, 11.2),
        (47.3, 34.7, 49.4, 33.2, 22.9, 10.7),
    ]
)
# Adult processes, mm: transverse process tip to tip (Panjabi 1991, 1992), spinous process from the canal's rear wall
# to the tip and the angle of its drop (design, after the same papers' spinous lengths).
_ADULT_TRANSVERSE = np.array([75, 69, 61, 59, 60, 60, 60, 59, 59, 58, 52, 47, 71, 76, 86, 79, 82], dtype=float)
_ADULT_SPINOUS = np.array([32, 32, 33, 34, 35, 36, 36, 35, 33, 30, 27, 27, 31, 32, 33, 31, 26], dtype=float)
SPINOUS_DROP_DEG = np.array([35, 42, 48, 52, 55, 57, 57, 55, 50, 42, 30, 20, 10, 8, 8, 8, 10], dtype=float)
_ADULT_CANAL_DEPTH = 16.0  # Panjabi 1991, 1992: 15 to 18 mm at all levels


def _child(adult: np.ndarray) -> np.ndarray:
    return adult * SPINE_SCALE.reshape(-1, *[1] * (adult.ndim - 1))


def _inner_length(levels: slice) -> float:
    # All bodies and the discs between them.
    return float(_ADULT[levels, 4:].sum() - _ADULT[levels.stop - 1, 5])


SPINE_SCALE = np.where(
    [name.startswith("T") for name in VERTEBRAE],
    THORACIC_LENGTH / _inner_length(slice(0, 12)),
    LUMBAR_LENGTH / _inner_length(slice(12, 17)),
)
VERTEBRA_SIZES = _child(_ADULT)  # (17, 6): width and depth above, width and depth below, height, disc below
TRANSVERSE_HALF = 0.5 * _child(_ADULT_TRANSVERSE)
SPINOUS_LENGTH = _child(_ADULT_SPINOUS)
CANAL_DEPTH = _ADULT_CANAL_DEPTH  # the canal is adult-sized from about six years

# Sagittal shape. Kyphosis 38 +- 8 at 10 to 14 years (Voutsinas); lordosis 48.5, sacral slope 41 at 4 to 18 years
# (Mac-Thiong 2004); the slope is lowered (33 in a Chinese series) to bring T1 over the sacrum.
KYPHOSIS_DEG, LORDOSIS_DEG, SACRAL_SLOPE_DEG = 38.0, 45.0, 31.0
# Shares of the curve per disc, T1-T2 ... T11-T12 (Bruno/Schmid generic model), then T12-L1, L1-L2 ... L5-S1 (design,
# growing downwards as there).
THORACIC_SHARES = np.array([1.0, 3.0, 4.0, 6.0, 6.0, 6.0, 6.0, 5.0, 4.0, 5.0, 4.0])
THORACOLUMBAR_DEG = 2.0
LUMBAR_SHARES = np.array([5.0, 6.0, 9.0, 11.0, 14.0])

# Ribs 1-12, adult bony part from head to costochondral junction, measured on a generic adult's centrelines:
# arc length, forward run, drop, lateral end, greatest lateral reach.
ADULT_RIBS = np.array(
    [
        (140, 49, 44, 39, 62),
        (238, 93, 70, 35, 92),
        (291, 117, 88, 48, 113),
        (325, 136, 108, 59, 124),
        (344, 151, 123, 68, 131),
        (352, 155, 136, 78, 136),
        (344, 149, 142, 94, 140),
        (331, 133, 152, 111, 144),
        (304, 111, 139, 120, 144),
        (263, 75, 126, 128, 138),
        (184, 25, 95, 121, 121),
        (109, 9, 64, 74, 74),
    ],
    dtype=float,
)
# Chest of the girl over the adult of that table: breadth 24.3 to 29.9 cm, depth 16.2 to 20.8 cm (Heinz 2003's adults
# and power laws at AnthroKids means); the depth's factor, 0.78, lowered because that adult's chest is deep for her
# breadth; height as the thoracic spine, 0.91, lowered with it: pump-handle angles within 6 degrees of the table.
RIB_SCALE_LATERAL, RIB_SCALE_FORWARD, RIB_SCALE_DOWN = 0.83, 0.70, 0.87
RIB_HALF_THICKNESS, RIB_HALF_HEIGHT = 2.7, 5.3  # adult section about 6 x 12 mm

# Sternum: jugular notch below and before the T1-T2 disc; the ten costal notches below it; design after adult
# proportions (manubrium 45-50, body 95-105 mm; 80 to 90 % of it at 12 years).
JUGULAR_NOTCH = (-18.0, 49.0)  # (y, z) from the T1-T2 disc
# The joint lies between the sternum's border and the end of the cartilage.
COSTAL_NOTCHES_DOWN = np.array([13.0, 38.0, 60.0, 82.0, 101.0, 116.0, 128.0, 136.0, 143.5, 151.0])
COSTAL_NOTCHES_HALF = np.array([22.0, 14.0, 14.5, 15.5, 17.0, 16.5, 14.5, 11.0, 9.0, 7.5])
STERNUM_SLOPE = 0.22  # forward per mm down: 12 degrees (design; adults 15 to 25)

# Shoulder: clavicle 136 mm at 13 years, girls (McGraw 2009); humeral head 44 mm adult (women), 0.88 of it at 12 years;
# half distance of the sternoclavicular joints 31 mm adult.
CLAVICLE_LENGTH, HUMERAL_HEAD = 136.0, 0.88 * 44.0
STERNOCLAVICULAR_HALF = 24.0

BI_ILIAC = 266.0  # Berkeley growth study, girls of 13
WAIST = (240.0, 174.0)  # breadth and depth whose girth is AnthroKids' 67.7 cm less 1 cm
