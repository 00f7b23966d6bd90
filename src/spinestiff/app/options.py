"""Values of options: numbers, refused where they are read before a command does anything; words that a shell offers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args, get_type_hints

import typer

from spinestiff.errors import OptionError
from spinestiff.formats import plain_number, plain_word

Check = Callable[[typer.CallbackParam, float | None], float | None]
Limits = Callable[[], tuple[float, float]]


def within(unit: str, limits: Limits, above: bool = False) -> Check:
    """A callback of an option that lets finite numbers within limits pass, and None.

    Parameters
    ----------
    unit : of the number, for the message.
    limits : gives the least and the greatest value; called with the first value, so that help imports nothing heavy.
    above : the least value itself is refused.

    Raises
    ------
    OptionError : no number, not finite, or outside; names option, value and limits.
    """

    def check(param: typer.CallbackParam, value: float | None) -> float | None:
        if value is not None:
            _check_within(f"{param.opts[0]} {value:g}", value, unit, limits, above)
        return value

    return check


def _check_within(given: str, value: float, unit: str, limits: Limits, above: bool = False) -> None:
    low, high = limits()
    # In this form NaN is refused, too.
    if not low <= value <= high or (above and value == low):
        wanted = f"above {low:g} and at most {high:g}" if above else f"{low:g} to {high:g}"
        raise OptionError(f"{given}: wanted {wanted} {unit}")


def check_plain(command: Any, texts: Mapping[str, Any]) -> None:
    """Raise OptionError for what a command's option takes for a number and is none.

    Nor is one what Python alone takes: with underscores.

    Parameters
    ----------
    texts : what was given, by the names of the command's parameters; what is no text passes.
    """
    hints = get_type_hints(command.callback)
    for param in command.params:
        text, hint = texts.get(param.name), hints.get(param.name)
        kinds = {int, float} & {hint, *get_args(hint)}
        if not kinds or not isinstance(text, str):
            continue
        given = f"{param.opts[0]} {text[:40]}"
        if "_" in text:
            raise OptionError(f"{given}: wanted a number, without underscores")
        if not _is_number(text, whole=float not in kinds):
            wanted = "a number" if float in kinds else "a whole number, in digits"
            raise OptionError(f"{given}: wanted {wanted}{' (a decimal point, no comma)' if ',' in text else ''}")


def _is_number(text: str, whole: bool) -> bool:
    """Also NaN and infinity where it need not be whole: limits refuse them."""
    try:
        number = float(text)
    except ValueError:
        return False
    return not whole or (number.is_integer() and "e" not in text.casefold())


def by_picture(option: str, texts: Sequence[str], limits: Limits) -> dict[str, float]:
    """Lengths "MM" or "PICTURE=MM" by the picture; "" stands for all pictures.

    Parameters
    ----------
    limits : mm.

    Raises
    ------
    OptionError : no number, outside the limits, or twice for a picture.
    """
    found: dict[str, float] = {}
    for text in texts:
        picture, equals, number = (part.strip() for part in text.rpartition("="))
        given = f"{option} {text[:80]}"
        value = plain_number(number)
        if math.isnan(value):
            raise OptionError(f"{given}: wanted MM, or PICTURE=MM, e.g. rest/lateral=1500")
        if equals and not picture:
            raise OptionError(f"{given}: wanted the name of a picture before =, e.g. rest/lateral=1500")
        if picture in found:
            raise OptionError(f"{given}: given twice for {picture or 'all pictures'}; wanted once")
        _check_within(given, value, "mm", limits)
        found[picture] = value
    return found


def by_level(option: str, texts: Sequence[str]) -> dict[str, dict[str, float]]:
    """Sizes of the trunk "LEVEL=BREADTH,DEPTH", mm, by the level, as ``subject.json`` has them.

    Raises
    ------
    OptionError : no level or numbers, outside the limits, or twice for a level.
    """
    from spinestiff.anatomy.names import VERTEBRAE
    from spinestiff.subject.records import BREADTHS_MM, DEPTHS_MM

    found: dict[str, dict[str, float]] = {}
    for text in texts:
        level, _, sizes = (part.strip() for part in text.partition("="))
        given, numbers = f"{option} {text[:80]}", [plain_number(part) for part in sizes.split(",")]
        if level not in VERTEBRAE or len(numbers) != 2 or any(math.isnan(value) for value in numbers):
            raise OptionError(f"{given}: wanted LEVEL=BREADTH,DEPTH, a vertebra from T1 to L5 and mm, e.g. T9=245,172")
        if level in found:
            raise OptionError(f"{given}: given twice for {level}; wanted once")
        _check_within(f"{given}, breadth {numbers[0]:g}", numbers[0], "mm", lambda: BREADTHS_MM)
        _check_within(f"{given}, depth {numbers[1]:g}", numbers[1], "mm", lambda: DEPTHS_MM)
        found[level] = {"breadth_mm": numbers[0], "depth_mm": numbers[1]}
    return found


def height_limits() -> tuple[float, float]:
    """cm, of the template."""
    from spinestiff.anatomy.template.body import HEIGHT_RANGE_CM

    return HEIGHT_RANGE_CM


def own_height_limits() -> tuple[float, float]:
    """cm, of a torso of one's own bones."""
    from spinestiff.anatomy.importing.naming import HEIGHTS_CM

    return HEIGHTS_CM


def age_limits() -> tuple[float, float]:
    """Years, of the template."""
    from spinestiff.anatomy.template.body import AGE_RANGE_YEARS

    return AGE_RANGE_YEARS


def mass_limits() -> tuple[float, float]:
    """kg, from the lightest of the smallest to the heaviest of the tallest; narrower at a body's own height."""
    from spinestiff.anatomy.template.body import BMI_RANGE, HEIGHT_RANGE_CM

    low, high = (index * (0.01 * height) ** 2 for index, height in zip(BMI_RANGE, HEIGHT_RANGE_CM))
    return low, high


def kyphosis_limits() -> tuple[float, float]:
    """Degrees, of the template."""
    from spinestiff.anatomy.template.body import KYPHOSIS_RANGE_DEG

    return KYPHOSIS_RANGE_DEG


def lordosis_limits() -> tuple[float, float]:
    """Degrees, of the template."""
    from spinestiff.anatomy.template.body import LORDOSIS_RANGE_DEG

    return LORDOSIS_RANGE_DEG


def spacing_limits() -> tuple[float, float]:
    """mm, of a tissue mesh's corners."""
    from spinestiff.anatomy.meshing import SPACINGS_MM

    return SPACINGS_MM


def node_limits() -> tuple[float, float]:
    """Nodes of a synthetic subject's own tissue mesh."""
    from spinestiff.personalise.rebuild import NODES

    return NODES


def marker_limits() -> tuple[float, float]:
    """Skin markers of a synthetic subject."""
    from spinestiff.subject.marker_table import FEWEST, MOST

    return FEWEST, MOST


def cobb_limits() -> tuple[float, float]:
    """Degrees, of a synthetic curve."""
    from spinestiff.study.synthetic.spines import LARGEST_COBB_DEG

    return -LARGEST_COBB_DEG, LARGEST_COBB_DEG


def force_limits() -> tuple[float, float]:
    """N, of a synthetic push."""
    from spinestiff.subject.records import GAUGE_LIMIT_N

    return 0.0, GAUGE_LIMIT_N


def noise_limits() -> tuple[float, float]:
    """Pixels, of a corner's noise; above, no vertebra would be told from its neighbours."""
    return 0.0, 1000.0


def push_limits() -> tuple[float, float]:
    """N, of a push that is planned: from what moves a spine to what the gauge reads."""
    from spinestiff.study.planning.wish import LEAST_LIMIT_N
    from spinestiff.subject.records import GAUGE_LIMIT_N

    return LEAST_LIMIT_N, GAUGE_LIMIT_N


def dose_limits() -> tuple[float, float]:
    """In any unit of dose."""
    return 0.0, 1e6


def offering(*words: str) -> Callable[[str], list[str]]:
    """What a shell offers as the value of an option (``autocompletion``): of these words those that go on so.

    They are all that there are; the words are written out, so that a shell need not wait for heavy imports.
    """

    def offered(incomplete: str) -> list[str]:
        return [word for word in words if word.startswith(incomplete)]

    return offered


def among(*words: str) -> Callable[[typer.CallbackParam, str | None], str | None]:
    """A callback of an option that makes of its text the word that was meant (``plain_word``); None passes.

    Raises
    ------
    OptionError : none of these words.
    """

    def check(param: typer.CallbackParam, value: str | None) -> str | None:
        found = None if value is None else plain_word(value, words)
        if value is not None and found is None:
            raise OptionError(f"{param.opts[0]} {value[:40]}: wanted {' or '.join(words)}")
        return found

    return check


def oldest_limits() -> tuple[float, float]:
    """Years, of a subject."""
    from spinestiff.subject.records import OLDEST

    return 0.0, OLDEST


def body_mass_limits() -> tuple[float, float]:
    """kg, of a subject; narrower at a body's own height."""
    from spinestiff.subject.records import HEAVIEST_KG

    return 0.0, HEAVIEST_KG


def stature_limits() -> tuple[float, float]:
    """cm, of a subject."""
    from spinestiff.subject.records import HEIGHTS_CM

    return HEIGHTS_CM


def level_limits() -> tuple[float, float]:
    """Ribs, of a push."""
    from spinestiff.subject.records import LEVELS

    return LEVELS


def rate_limits() -> tuple[float, float]:
    """Hz, of a force log."""
    from spinestiff.subject.intake.force_log import RATES_HZ

    return RATES_HZ


def distance_limits() -> tuple[float, float]:
    """mm, between supports and push."""
    from spinestiff.subject.records import DISTANCES_MM

    return DISTANCES_MM


def source_limits() -> tuple[float, float]:
    """mm, of an X-ray source from detector or patient."""
    from spinestiff.imaging.dicom.millimetres import SOURCE_MM

    return SOURCE_MM


def pixel_limits() -> tuple[float, float]:
    """mm, of a detector's pixel."""
    from spinestiff.imaging.dicom.millimetres import PIXEL_MM

    return PIXEL_MM


def minute_limits() -> tuple[float, float]:
    """Minutes that one subject of a cohort may take, up to 30 days."""
    return 0.0, 43200.0


def memory_limits() -> tuple[float, float]:
    """GB (2^30 bytes) that one subject of a cohort may take."""
    return 0.0, 10000.0


def difference_limits() -> tuple[float, float]:
    """A factor between two stiffnesses, the larger over the smaller."""
    return 1.0, 100.0


def upload_limits() -> tuple[float, float]:
    """GB (2^30 bytes) of one upload."""
    return 0.0, 1000.0
