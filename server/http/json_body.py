"""JSON bodies of a bounded size and a known shape."""

from __future__ import annotations

import json
from typing import NoReturn, TypeVar

from pydantic import BaseModel, ValidationError
from starlette.requests import Request

from chamfer_morph.server.http.body import chunks, media_type
from chamfer_morph.server.http.problems import ProblemError, validation_problem
from chamfer_morph.worker.settings import Settings

Model = TypeVar("Model", bound=BaseModel)


async def read_json(request: Request, model: type[Model], settings: Settings) -> Model:
    """The body as JSON of a known shape.

    Raises:
        ProblemError: 415, 413, 408 or 422.
    """
    if media_type(request) != "application/json":
        raise ProblemError(
            415, "The body is not JSON.", "Send it with Content-Type: application/json."
        )
    body = bytearray()
    async for chunk in chunks(request, settings.body_bytes, settings):
        body += chunk
    return parse_json(bytes(body), model)


def parse_json(body: bytes, model: type[Model]) -> Model:
    """JSON of a known shape.

    Raises:
        ProblemError: 422.
    """
    return validate(load_json(body), model)


def load_json(body: bytes) -> object:
    """Any JSON, without the numbers that JSON does not have.

    Raises:
        ProblemError: 422.
    """
    try:
        return json.loads(body, parse_constant=_refuse_constant)
    except RecursionError:
        raise ProblemError(422, "The JSON is nested too deeply.", "Flatten it.") from None
    except ValueError as error:
        raise ProblemError(
            422, f"The body is not JSON: {error}.", "Check it with a JSON linter."
        ) from None


def validate(value: object, model: type[Model]) -> Model:
    """A value of a known shape.

    Raises:
        ProblemError: 422.
    """
    try:
        return model.model_validate(value)
    except ValidationError as error:
        raise validation_problem(error) from None


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number of JSON")
