"""Validators of JSON Schemas and of manifests, imported by the tests that use them.

The formats of jsonschema take 2 s of CPU time, and each worker imports every file of tests.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType


@cache
def jsonschema() -> ModuleType:
    """Import jsonschema."""
    return import_module("jsonschema")


@cache
def kubernetes_validate() -> ModuleType:
    """Import the schemas of Kubernetes, which import jsonschema."""
    return import_module("kubernetes_validate")


def find_schema_mistakes(schema: str, *paths: Path) -> str:
    """Check files by the command check-jsonschema, in this process.

    Args:
        schema: A schema of the command, such as `vendor.compose-spec`.
        paths: YAML files.

    Returns:
        What it prints about mistakes; empty without one.
    """
    command = import_module("check_jsonschema").main
    runner = import_module("click.testing").CliRunner()
    done = runner.invoke(command, ["--builtin-schema", schema, *map(str, paths)])
    return f"{done.output}{done.exception or ''}" if done.exit_code else ""
