"""Validators of JSON Schemas and of manifests, imported by the tests that use them.

The formats of jsonschema take 2 s of CPU time, and each worker imports every file of tests.
"""

from functools import cache
from importlib import import_module
from types import ModuleType


@cache
def jsonschema() -> ModuleType:
    """Import jsonschema."""
    return import_module("jsonschema")


@cache
def kubernetes_validate() -> ModuleType:
    """Import the schemas of Kubernetes, which bring jsonschema along."""
    return import_module("kubernetes_validate")
