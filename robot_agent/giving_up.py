"""How a wait ends that was in vain: the error that it met, and for how long it waited."""

from typing import NoReturn

from zensim.proto.messages.result_messages import ServiceError


def give_up(error: Exception, wait_s: float) -> NoReturn:
    """Raise an error again, with the time that was waited [s] in its text.

    Raises:
        ServiceError: When the error is one; else one of the error's own class.
    """
    waited = f" (waited {wait_s:.1f} s)" if wait_s else ""
    if isinstance(error, ServiceError):
        text = f"{error.message}{waited}"
        raise ServiceError(error.service, error.code, error.code_name, text) from error
    raise type(error)(f"{error}{waited}") from error
