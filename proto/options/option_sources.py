"""Where the value of an option comes from: default, file, variable or flag."""

import os
from typing import Final

import typer

from zensim.proto.setting_variables import name_variable

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


def find_unused_endpoint(context: typer.Context, command: str) -> str:
    """Find which of `connect` and `listen` `up` or `serve` does not use; empty = none.

    ZENSIM_CONNECT is meant for clients: a server that need not connect does not read it.
    """
    own = os.environ.get(name_variable(command, "connect"))
    is_for_clients = find_source(context, "connect") == "ENVIRONMENT" and not own
    if command == "up":
        return "connect" if is_for_clients else ""
    listens, connects = context.params.get("listen"), context.params.get("connect")
    if listens and (is_for_clients or takes_precedence(context, "listen", over="connect")):
        return "connect"
    return "listen" if connects and takes_precedence(context, "connect", over="listen") else ""
