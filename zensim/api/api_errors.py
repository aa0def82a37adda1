"""Errors of the Python API: each has a code, a slug, a message and a hint."""

import re
from typing import NoReturn

from zensim.proto.messages.result_messages import ResultCode, ServiceError

SLUG = re.compile(r"([a-z0-9_]+(?:\.[a-z0-9_]+)*): ")
SPAWN_SERVICES = frozenset({"spawn_entity", "spawn_entities"})
STEPPED_ELSEWHERE = "stepped_elsewhere"
ACCESS_DENIED = "access.denied"
"""What a secured server says to a user whose role does not permit a request."""


class Error(Exception):
    """Root of all errors of the API.

    Attributes:
        code: Result code of the service, else one of `ResultCode`.
        slug: Identifies the error for programs, such as `entity_gone`.
        message: What was given, and what is wrong.
        hint: What would work; may be empty.
    """

    code: int = ResultCode.OPERATION_FAILED
    slug = "failed"
    hint = ""

    def __init__(self, message: str, *, slug: str = "", hint: str = "", code: int = 0) -> None:
        super().__init__(message)
        self.message = message
        self.slug = slug or type(self).slug
        self.hint = hint or type(self).hint
        self.code = code or type(self).code

    def __str__(self) -> str:
        """Write message and hint in one line."""
        return f"{self.message}; {self.hint}" if self.hint else self.message

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle it with its attributes."""
        return _rebuild, (type(self), self.message, self.slug, self.hint, self.code)


def _rebuild(kind: type[Error], message: str, slug: str, hint: str, code: int) -> Error:
    return kind(message, slug=slug, hint=hint, code=code)


class NotFound(Error, KeyError):
    """No robot, entity, model, world or topic has this name."""

    code = ResultCode.NOT_FOUND
    slug = "not_found"


class Invalid(Error, ValueError):
    """An argument has a wrong type, shape or range."""

    slug = "invalid"


class Timeout(Error, TimeoutError):
    """Something did not happen, or no reply arrived, in time."""

    slug = "timeout"


class Unreachable(Error, ConnectionError):
    """No server can be reached at the endpoint."""

    slug = "unreachable"
    hint = "start one with 'zensim serve', or use zensim.launch()"


class ConnectionLost(Error, ConnectionError):
    """The server was there and does not reply any more."""

    slug = "connection_lost"
    hint = "check that the server runs, then connect again"


class Denied(Error, PermissionError):
    """The role of the token does not permit this."""

    slug = ACCESS_DENIED


class SpawnRefused(Error):
    """The server refused a spawn, for example because of the description."""

    slug = "spawn_refused"


class SteppedElsewhere(Error):
    """Another client steps the simulation."""

    code = ResultCode.INCORRECT_STATE
    slug = STEPPED_ELSEWHERE
    hint = "wait until it has ended"


class Unsupported(Error, NotImplementedError):
    """This simulation cannot do this."""

    code = ResultCode.FEATURE_UNSUPPORTED
    slug = "unsupported"


class Closed(Error):
    """The simulation is closed, or belongs to another process."""

    code = ResultCode.INCORRECT_STATE
    slug = "closed"
    hint = "connect again"


def refuse_pickling(kept: object, hint: str) -> NoReturn:
    """Refuse to pickle what belongs to its process.

    Raises:
        Error: Always.
    """
    raise Error(f"{type(kept).__name__} cannot be pickled", slug="not_picklable", hint=hint)


API_WORDS = {
    "set allow_renaming": "give none",
    "get_available_worlds lists all worlds": "worlds() lists all",
}
"""What the API calls what messages of services name."""


def to_api_error(refusal: ServiceError) -> Error:
    """Convert the refusal of a service; its slug is the one in its message, else its code name."""
    found = SLUG.match(refusal.message)
    slug = found[1] if found else refusal.code_name.lower()
    text = refusal.message[found.end() :] if found else refusal.message
    for theirs, ours in API_WORDS.items():
        text = text.replace(theirs, ours)
    message, _, hint = text.partition("; ")
    kind = _choose_kind(refusal, slug)
    return kind(message or refusal.code_name, slug=slug, hint=hint, code=refusal.code)


def _choose_kind(refusal: ServiceError, slug: str) -> type[Error]:
    if slug == STEPPED_ELSEWHERE:
        return SteppedElsewhere
    if slug == ACCESS_DENIED:
        return Denied
    if refusal.service in SPAWN_SERVICES:
        return SpawnRefused
    by_code = {
        int(ResultCode.NOT_FOUND): NotFound,
        int(ResultCode.FEATURE_UNSUPPORTED): Unsupported,
    }
    return by_code.get(refusal.code, Error)
