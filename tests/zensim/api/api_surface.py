"""`python -m tests.zensim.api.api_surface`: write docs/api.json, the names of the Python API."""

import inspect
import json
import re
from collections.abc import Iterator

import zensim
from benchmarks.machine import ROOT
from zensim.api.spawning import DescriptionKeywords, FleetKeywords, SpawnKeywords, list_keywords
from zensim.proto.settings.server_settings import WorldKeywords
from zensim.public_names import list_public_names

DOCUMENT = ROOT / "docs" / "api.json"
KEYWORDS = {
    one.__name__: one for one in (DescriptionKeywords, FleetKeywords, SpawnKeywords, WorldKeywords)
}
OPTIONS = re.compile(r"\*\*options: 'Unpack\[(\w+)\]'")
ADDRESS = re.compile(r" at 0x[0-9a-f]+")


def describe_surface() -> dict[str, object]:
    """Describe all public names: signatures of functions, members of classes."""
    return {
        name: _describe(getattr(zensim, name)) for name in list_public_names() if name[0] != "_"
    }


def _describe(found: object) -> object:
    if inspect.isclass(found):
        return dict(sorted(_list_members(found)))
    return _write_signature(found) if callable(found) else type(found).__name__


def _list_members(kind: type) -> Iterator[tuple[str, str]]:
    for name, member in inspect.getmembers(kind):
        is_ours = any(
            name in vars(base) for base in kind.__mro__ if base.__module__.startswith("zensim")
        )
        if name.startswith("_") or not is_ours:
            continue
        yield name, _write_signature(member) if callable(member) else _name_kind(member)


def _name_kind(member: object) -> str:
    return "property" if isinstance(member, property) else "attribute"


def _write_signature(function: object) -> str:
    if not callable(function):
        return ""
    signature = inspect.signature(function)
    parameters = [one.replace(annotation=one.empty) for one in signature.parameters.values()]
    bare = signature.replace(parameters=parameters, return_annotation=signature.empty)
    options = [
        _write_keywords(found[1])
        for one in signature.parameters.values()
        if (found := OPTIONS.search(str(one)))
    ]
    return ADDRESS.sub("", str(bare)).replace("**options", "".join(options) or "**options")


def _write_keywords(name: str) -> str:
    return "*, " + ", ".join(f"{one}=…" for one in list_keywords(KEYWORDS[name]))


def main() -> None:
    """Write the document."""
    text = json.dumps(describe_surface(), indent=2, ensure_ascii=False) + "\n"
    DOCUMENT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
