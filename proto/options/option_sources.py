"""Where the value of an option comes from: default, file, variable or flag."""

import os
from typing import Final

import typer

SOURCES: Final = ("DEFAULT", "DEFAULT_MAP", "ENVIRONMENT", "COMMANDLINE")
"""Sources of values: default, file, variable, flag; later ones take precedence."""


def find_source(context: typer.Context, parameter: str) -> str:
    """Find the source of the value of an option; one of `SOURCES`."""
    source = context.get_parameter_source(parameter)
    return source.name if source is not None and source.name in SOURCES else SOURCES[0]


def takes_precedence(context: typer.Context, parameter: str, *, over: str) -> bool:
    """Whether the value of an option comes from a stronger source than that of another."""
    strength = [SOURCES.index(find_source(context, name)) for name in (parameter, over)]
    return strength[0] > strength[1]


def is_exported_for_clients(context: typer.Context, own_variable: str) -> bool:
    """Whether the endpoint to connect to comes from ZENSIM_CONNECT, which is meant for clients.

    Args:
        context: Of a command that need not connect.
        own_variable: Names the endpoint for that command only.
    """
    is_exported = find_source(context, "connect") == "ENVIRONMENT"
    return is_exported and not os.environ.get(own_variable)
