"""Options of a command as the fields of a dataclass, so that commands can share them."""

import dataclasses
import inspect
from collections.abc import Callable
from typing import TypeVar

Options = TypeVar("Options")


def takes(
    kind: Callable[..., Options],
) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Let typer see the fields of a dataclass as the parameters of a command.

    Args:
        kind: A dataclass whose fields typer could have as parameters.
    """

    def wrap(action: Callable[[Options], None]) -> Callable[..., None]:
        def command(**given: object) -> None:
            action(kind(**given))

        command.__name__ = action.__name__
        command.__doc__ = action.__doc__
        command.__signature__ = inspect.Signature(_parameters(kind))  # type: ignore[attr-defined]
        return command

    return wrap


def _parameters(kind: Callable[..., Options]) -> list[inspect.Parameter]:
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty
            if field.default is dataclasses.MISSING
            else field.default,
            annotation=field.type,
        )
        for field in dataclasses.fields(kind)  # type: ignore[arg-type]
    ]
