"""Plants an unknown tag and attribute into each element of a file, and finds what stays silent.

`python -m tests.sim_server.description.planted_words FILE...` lists the silent places of files,
whose elements without effect may be reported as a whole.
"""

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from lxml import etree
from lxml.etree import _Element as Element

from zensim.proto.messages.model_messages import ReportEntry
from zensim.sim_server.description.element_rules import ElementRule, find_name
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.errors import ModelError

TAG, ATTRIBUTE = "planted_tag", "planted_attribute"
UNUSED = ("ignored", "unknown", "suspicious")

Report = Callable[[str], Iterable[ReportEntry]]


def report_robot(text: str) -> tuple[ReportEntry, ...]:
    """Report a robot without its meshes."""
    return read_robot(text, allow_missing=True).report


def report_world(text: str) -> tuple[ReportEntry, ...]:
    """Report a world without its included models and meshes."""
    return read_world(text, allow_missing=True).report


def find_silent_places(text: str, report: Report, *, is_strict: bool = True) -> list[str]:
    """List the elements in which a word is neither in the report nor in an error.

    Args:
        text: Of the file.
        report: Reads and reports it.
        is_strict: Whether no element may be reported as a whole instead.
    """
    root = etree.fromstring(text.encode())
    return [
        f"{word} in {'/'.join(str(one.tag) for one in reversed(around))}"
        for around, planted in _plant(root)
        for word in _find_silent_words(report, planted, () if is_strict else around)
    ]


def _plant(root: Element) -> Iterator[tuple[list[Element], str]]:
    for element in list(root.iter("*")):
        planted = etree.SubElement(element, TAG)
        element.set(ATTRIBUTE, "1")
        yield [element, *element.iterancestors()], etree.tostring(root).decode()
        element.remove(planted)
        element.attrib.pop(ATTRIBUTE)


def _find_silent_words(report: Report, text: str, around: Iterable[Element]) -> list[str]:
    try:
        entries = report(text)
    except ModelError:
        return []
    said = [one.subject for one in entries if one.status in UNUSED]
    names = [f"<{one.tag}>" for one in around]
    names += [f"{one.tag} {one.get('name')!r}" for one in around if one.get("name")]
    if any(name in subject for name in names for subject in said):
        return []
    return [word for word in (TAG, ATTRIBUTE) if not any(word in subject for subject in said)]


def find_missing_rules(rule: ElementRule, elements: Iterable[Element]) -> Iterator[str]:
    """List the tags that a table knows, and that have an effect, and that no element has."""
    given = list(elements)
    for tag, below in rule.children.items():
        found = [child for one in given for child in one if find_name(child) == tag]
        if not below.unread and not found:
            yield tag
        elif not below.unread:
            yield from (f"{tag}/{inner}" for inner in find_missing_rules(below, found))


def main(files: Iterable[str]) -> None:
    """Print the silent places of files."""
    for file in files:
        text = Path(file).read_text(encoding="utf-8")
        report = report_world if "<world" in text else report_robot
        places = find_silent_places(text, report, is_strict=False)
        sys.stdout.write("\n".join([f"{file}: {len(places)} silent places", *places]) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
