"""Pseudonyms by a keyed hash: the same key gives the same patient, UID and shift of dates; without it no way back."""

from __future__ import annotations

import datetime
import hashlib
import hmac
import json
import os
import re
import secrets
import uuid
from dataclasses import dataclass, field
from pathlib import Path

from spinestiff.errors import RadiographError
from spinestiff.files import regular_file, trouble, write_bytes
from spinestiff.words import counted

FEWEST_KEY_BYTES, MOST_KEY_BYTES = 16, 4096
_RANDOM_LINE = re.compile(r"[A-Za-z0-9+/=_-]+|-----[A-Z0-9 ]+-----")
NO_DATE = datetime.date(1900, 1, 1)
"""Stands where a file tells a time but no date, so that times of a night keep their order when they are shifted."""
_SHIFT_S = (365 * 86400, 3650 * 86400)


@dataclass(frozen=True)
class Key:
    """A secret that pseudonyms are made with (HMAC-SHA256); never written beside them and never shown."""

    secret: bytes = field(repr=False)

    def __post_init__(self) -> None:
        if not FEWEST_KEY_BYTES <= len(self.secret) <= MOST_KEY_BYTES:
            raise RadiographError(
                f"a key of {counted(len(self.secret), 'byte')}; wanted {FEWEST_KEY_BYTES} to {MOST_KEY_BYTES}"
            )

    def digest(self, kind: str, value: str) -> bytes:
        """32 bytes that stand for a value of a kind."""
        return hmac.new(self.secret, f"{kind}\0{value}".encode(), hashlib.sha256).digest()

    def uid(self, uid: str) -> str:
        """A UID in place of another: 2.25 and a UUID of version 8 (PS3.5 B.2, RFC 9562)."""
        digest = bytearray(self.digest("uid", uid)[:16])
        digest[6] = 0x80 | digest[6] & 0x0F
        digest[8] = 0x80 | digest[8] & 0x3F
        return f"2.25.{uuid.UUID(bytes=bytes(digest)).int}"

    def patient(self, identity: str) -> str:
        """A pseudonym, e.g. "P3F0A19C2D4E7"."""
        return "P" + self.digest("patient", identity)[:6].hex().upper()

    def shift(self, identity: str) -> datetime.timedelta:
        """How far a patient's dates and times are moved into the past: one to ten years, to the second."""
        low, high = _SHIFT_S
        number = int.from_bytes(self.digest("shift", identity)[:8])
        return datetime.timedelta(seconds=low + number % (high - low))


def random_key() -> Key:
    """A key for one run, kept nowhere."""
    return Key(secrets.token_bytes(32))


def key_of(path: Path) -> tuple[Key, bool]:
    """The key in a file (its bytes without white space at the ends), and whether it was made just now.

    A file that isn't there is made, with a random key, for its owner alone to read.

    Raises
    ------
    RadiographError : a file that can't be read or written, is too short or too long for a key, or holds something else:
        text of several lines, JSON or XML, a DICOM file.
    """
    try:
        if not os.path.lexists(path):
            text = secrets.token_hex(32)
            write_bytes(path, f"{text}\n".encode(), RadiographError, name="key file", private=True)
            return Key(text.encode()), True
        if regular_file(path, RadiographError, name="key file").st_size > MOST_KEY_BYTES:
            raise RadiographError(f"key file: over {MOST_KEY_BYTES} bytes; is it the right file?")
        content = path.read_bytes().strip()
        if _no_secret(content):
            raise RadiographError("key file: holds data or text, not a key (one line, or random bytes); name another")
        return Key(content), False
    except OSError as problem:
        raise RadiographError(f"key file: can't be read ({trouble(problem)})") from None


def _no_secret(content: bytes) -> bool:
    """Whether a file's content is something that others may have, too: text of several lines, JSON or XML, DICOM.
    Random bytes as text are often broken into lines: base64, hexadecimal digits and PEM are keys."""
    if content[128:132] == b"DICM":
        return True
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return False
    lines = text.splitlines()
    if len(lines) > 1:
        return not all(_RANDOM_LINE.fullmatch(line) for line in lines)
    try:
        return isinstance(json.loads(text), (dict, list))
    except RecursionError:  # of brackets alone
        return True
    except ValueError:
        return text.startswith("<") and text.endswith(">")


def moment(date: str, time: str) -> datetime.datetime | None:
    """A DICOM date and time (DA and TM, also with the old . and : between their parts); None for what is neither.

    Without a date it is ``NO_DATE``; without a time it is noon.
    """
    date, time = date.strip(" \0").replace(".", ""), time.strip(" \0").replace(":", "")
    day = re.fullmatch(r"(\d{4})(\d\d)(\d\d)", date)
    clock = re.fullmatch(r"(\d\d)(\d\d)?(\d\d)?(?:\.(\d{1,6}))?", time)
    if (date and day is None) or (time and clock is None) or not (date or time):
        return None
    hours, minutes, seconds, fraction = clock.groups() if clock else ("12", None, None, None)
    micro = int((fraction or "").ljust(6, "0"))
    try:
        return datetime.datetime.combine(
            datetime.date(*map(int, day.groups())) if day else NO_DATE,
            datetime.time(int(hours), int(minutes or 0), min(int(seconds or 0), 59), micro),
        )
    except ValueError:
        return None
