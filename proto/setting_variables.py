"""Names of the variables of options, without the libraries of the command line."""

from collections.abc import Mapping
from typing import Final

CONFIG_VARIABLE: Final = "ZENSIM_CONFIG"
"""Names the file of `--config`."""


def name_variable(command: str, key: str) -> str:
    """Name the variable of an option.

    Args:
        command: As it is typed.
        key: Spelling without dashes.
    """
    return f"zensim_{command}_{key}".upper().replace("-", "_").replace(" ", "_")


def has_variables(command: str, environment: Mapping[str, str]) -> bool:
    """Whether the environment has a variable of a command, or names a file."""
    prefix = name_variable(command, "")
    given = [name for name, value in environment.items() if value]
    return CONFIG_VARIABLE in given or any(name.startswith(prefix) for name in given)
