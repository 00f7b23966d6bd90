"""What a page may send, checked before anything is done with it, and failures as one line of JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from fastapi import Depends, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError

from spinestiff.errors import ChangedElsewhere, InUseError, NotThere, SpinestiffError, SubjectError
from spinestiff.formats import parse_json
from spinestiff.subject.record_reading import Record, complaint_of, shown_value


class Sent(Record):
    """The body of a request: these keys and no others, each of its type."""


S = TypeVar("S", bound=Sent)


async def _body(request: Request) -> bytes:
    return await request.body()


Body = Annotated[bytes, Depends(_body)]
_NO_UTF8 = re.compile("[\ud800-\udfff]")
"""How Python keeps such bytes in a name: as halves of a surrogate pair."""


def sent(body: bytes, kind: type[S]) -> S:
    """A request's body. Raises SubjectError, in one line, for anything it may not be."""
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError:
        raise SubjectError("the request is no UTF-8 text") from None
    parse_json(text, "the request")
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        raise SubjectError(f"the request: {complaint_of(error)}") from None


def sendable(text: str) -> str:
    """Text that can be sent: bytes of a file's name that are no UTF-8 stand there as in an address, e.g. "M%FCller"."""
    return _NO_UTF8.sub(lambda one: f"%{ord(one[0]) & 0xFF:02X}", text)


class Told(JSONResponse):
    """JSON, ``sendable`` whatever names of files it holds."""

    def render(self, content: Any) -> bytes:
        """The body."""
        return sendable(json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))).encode()


def bare_application(words: Callable[[str], str] = str) -> FastAPI:
    """An application without pages of its own, whose failures are one line of JSON each, as ``words`` says them."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, default_response_class=Told)

    @app.exception_handler(SpinestiffError)
    def refused(_: Request, error: Exception) -> Told:
        statuses: tuple[tuple[type[Exception], int], ...] = (
            (ChangedElsewhere, 409),
            (InUseError, 409),
            (NotThere, 404),
        )
        status = next((status for kind, status in statuses if isinstance(error, kind)), 422)
        return Told({"error": " ".join(words(str(error)).split())}, status)

    @app.exception_handler(RequestValidationError)
    def malformed(_: Request, error: Exception) -> Told:
        assert isinstance(error, RequestValidationError)
        first = error.errors()[0]
        found = f"{'.'.join(map(str, first['loc'][1:]))}: found {shown_value(first['input'])}"
        return Told({"error": f"the request is not one of this page's: {found}"}, 422)

    @app.exception_handler(OSError)
    def unwritten(_: Request, error: Exception) -> Told:
        assert isinstance(error, OSError)
        return Told({"error": f"a file can't be read or written ({error.strerror})"}, 500)

    return app
