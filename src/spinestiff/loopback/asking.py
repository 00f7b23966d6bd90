"""What a page may send, checked before anything is done with it, and failures as one line of JSON."""

from __future__ import annotations

from typing import Annotated, TypeVar

from fastapi import Depends, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, ValidationError

from spinestiff.errors import ChangedElsewhere, InUseError, NotThere, SpinestiffError, SubjectError
from spinestiff.formats import parse_json
from spinestiff.subject.record_reading import complaint_of


class Sent(BaseModel):
    """The body of a request: these keys and no others, each of its type."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


S = TypeVar("S", bound=Sent)


async def _body(request: Request) -> bytes:
    return await request.body()


Body = Annotated[bytes, Depends(_body)]


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


def bare_application() -> FastAPI:
    """An application without pages of its own, whose failures are one line of JSON each."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)

    @app.exception_handler(SpinestiffError)
    def refused(_: Request, error: Exception) -> JSONResponse:
        statuses: tuple[tuple[type[Exception], int], ...] = (
            (ChangedElsewhere, 409),
            (InUseError, 409),
            (NotThere, 404),
        )
        status = next((status for kind, status in statuses if isinstance(error, kind)), 422)
        return JSONResponse({"error": " ".join(str(error).split())}, status)

    @app.exception_handler(RequestValidationError)
    def malformed(_: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"error": "the request is not one of this page's"}, 422)

    @app.exception_handler(OSError)
    def unwritten(_: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, OSError)
        return JSONResponse({"error": f"a file can't be read or written ({error.strerror})"}, 500)

    return app
