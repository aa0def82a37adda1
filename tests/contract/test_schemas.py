"""The committed schemas match the code, and stay small."""

import importlib
import json
import pkgutil

import msgspec

from zensim.proto import messages, schema

MAX_BYTES = 640 * 1024


def modules_with_structs() -> set[str]:
    names = [
        f"{messages.__name__}.{module.name}" for module in pkgutil.iter_modules(messages.__path__)
    ]
    return {
        name
        for name in names
        for member in vars(importlib.import_module(name)).values()
        if isinstance(member, type) and issubclass(member, msgspec.Struct)
        if member.__module__ == name
    }


def test_committed_schemas_match_the_code() -> None:
    assert schema.find_stale() == [], "run 'python -m zensim.proto.schema' and commit what it wrote"


def test_schemas_are_the_same_on_every_run() -> None:
    assert schema.make_artefacts() == schema.make_artefacts()


def test_schemas_are_small() -> None:
    sizes = {path.name: path.stat().st_size for path in schema.SCHEMAS.iterdir()}

    assert sum(sizes.values()) < MAX_BYTES


def test_schemas_cover_every_module_that_defines_messages() -> None:
    described = {kind.__module__ for kind in schema.list_messages().values()}

    assert modules_with_structs() == described


def test_schemas_refer_to_defined_types_only() -> None:
    text = (schema.SCHEMAS / "messages.json").read_text(encoding="utf-8")
    defined = json.loads(text)["$defs"].keys()

    referred = {line.split("/")[-1].rstrip('",') for line in text.splitlines() if '"$ref"' in line}

    assert referred
    assert referred <= defined
