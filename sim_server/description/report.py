"""The effect of each tag of a description, collected during parsing."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Literal

import msgspec

from zensim.proto.messages.model_messages import ReportEntry, ReportStatus

MAX_ENTRIES = 200
"""Entries of what is applied, and of what is not read; without suspicious and essential ones."""
MAX_SUSPICIOUS_ENTRIES = 600
"""More than one per link of the largest robot, so that no missing mesh is left out."""
MAX_ESSENTIAL_ENTRIES = 1000
"""More than all plug-ins of a robot give, each with its drive and what contradicts its links."""
MODEL_SEPARATOR = ": "
"""Separator of the model of a world and the subject of an entry of its report."""
MAX_NAMES = 3
"""Named by an entry that stands for several links, joints or plug-ins."""
ESSENTIAL_SUBJECTS = ("drive", "driving", "joint controllers")
"""Subjects whose entries decide how a robot moves, as do those of plug-ins and controllers."""
_ESSENTIAL_SUBJECT = re.compile(r"(?:plugin|controller) (?:'[^']*'|\"[^\"]*\")")
GROUPED: frozenset[ReportStatus] = frozenset({"applied", "ignored", "unknown"})
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_PART = re.compile(r"(?<=, visual) (?:\d+|'[^']*')|(?<=, collision) (?:\d+|'[^']*')")
_Kind = Literal["applied", "unread", "suspicious", "essential"]
_LIMITS: Mapping[_Kind, int] = {
    "applied": MAX_ENTRIES,
    "unread": MAX_ENTRIES,
    "suspicious": MAX_SUSPICIOUS_ENTRIES,
    "essential": MAX_ESSENTIAL_ENTRIES,
}


@dataclass
class _Occurrences:
    """How often an entry occurred, and the names that differ."""

    count: int = 0
    names: dict[str, None] = field(default_factory=dict)


class ParseReport:
    """Different entries in order; entries beyond the maximum of their kind are only counted.

    Entries that differ only in the first quoted name, such as that of a link, are one entry, which
    has their number and three of the names; suspicious ones are not. Suspicious entries and those
    of plug-ins and drives have limits of their own: no number of tags before them leaves them out.
    """

    def __init__(self) -> None:
        self._entries: dict[ReportEntry, _Occurrences] = {}
        self._counts = dict.fromkeys(_LIMITS, 0)
        self._left_out = 0
        self._similar: dict[tuple[str, tuple[str, ...]], list[str]] = {}

    def applied(self, subject: str, reason: str = "") -> None:
        """Report a tag that has an effect."""
        self._add("applied", subject, reason)

    def ignored(self, subject: str, reason: str) -> None:
        """Report a known tag that has no effect."""
        self._add("ignored", subject, reason)

    def unknown(self, subject: str, reason: str) -> None:
        """Report an unknown tag."""
        self._add("unknown", subject, reason)

    def suspicious(self, subject: str, reason: str) -> None:
        """Report a probable mistake."""
        self._add("suspicious", subject, reason)

    def repeat(self, entry: ReportEntry, *, of: str) -> None:
        """Copy an entry from the report of a model, named `of`, of this world."""
        found = ReportEntry(entry.status, f"''{MODEL_SEPARATOR}{entry.subject}", entry.reason)
        kind = _find_kind(entry.status, entry.subject)
        if entry.status in GROUPED:
            self._count(found, kind, name=of)
        else:
            subject = f"{of}{MODEL_SEPARATOR}{entry.subject}"
            self._count(msgspec.structs.replace(found, subject=subject), kind)

    def unread_tag(self, subject: str, tag: str, known: Iterable[str]) -> None:
        """Report an unknown tag; as suspicious if its name resembles a known one."""
        self._add_unread(f"{subject}: <{tag[:80]}>", tag, tuple(known), "<{}>")

    def unread_attribute(self, subject: str, name: str, known: Iterable[str]) -> None:
        """Report an unknown attribute; as suspicious if its name resembles a known one."""
        self._add_unread(f"{subject}: attribute {name[:80]}", name, tuple(known), "{}")

    def _add_unread(self, shown: str, name: str, known: tuple[str, ...], form: str) -> None:
        if not self._has_room("unread"):
            # The comparison is slow: a hostile file could have many unknown tags.
            self._left_out += 1
            return
        key = (name, known)
        if key not in self._similar:
            self._similar[key] = get_close_matches(name, known, n=1, cutoff=0.75)
        if similar := self._similar[key]:
            self.suspicious(shown, f"not read; did you mean {form.format(similar[0])}?")
        else:
            self.unknown(shown, "not read")

    def entries(self) -> tuple[ReportEntry, ...]:
        """List the entries, and the number of those left out."""
        listed = tuple(_describe(entry, found) for entry, found in self._entries.items())
        if not self._left_out:
            return listed
        more = ReportEntry("ignored", "report", f"{self._left_out} more entries are left out")
        return (*listed, more)

    def _add(self, status: ReportStatus, subject: str, reason: str) -> None:
        kind = _find_kind(status, subject)
        name = _QUOTED.search(subject) if status in GROUPED else None
        if name is None:
            self._count(ReportEntry(status, subject, reason), kind)
            return
        rest = _PART.sub("", subject[name.end() :])
        entry = ReportEntry(status, f"{subject[: name.start()]}''{rest}", reason)
        self._count(entry, kind, name=name.group())

    def _count(self, entry: ReportEntry, kind: _Kind, *, name: str = "") -> None:
        """Count an entry; `name` is that for which '' stands in its subject."""
        if entry not in self._entries:
            if not self._has_room(kind):
                self._left_out += 1
                return
            self._counts[kind] += 1
        found = self._entries.setdefault(entry, _Occurrences())
        found.count += 1
        if name:
            found.names[name] = None

    def _has_room(self, kind: _Kind) -> bool:
        return self._counts[kind] < _LIMITS[kind]


def _find_kind(status: ReportStatus, subject: str) -> _Kind:
    if subject in ESSENTIAL_SUBJECTS or _ESSENTIAL_SUBJECT.fullmatch(subject):
        return "essential"
    if status not in GROUPED:
        return "suspicious"
    return "applied" if status == "applied" else "unread"


def _describe(entry: ReportEntry, found: _Occurrences) -> ReportEntry:
    if not found.names:
        return entry
    names = list(found.names)
    shown, left_out = ", ".join(names[:MAX_NAMES]), len(names) - MAX_NAMES
    shown += f" and {left_out} more" if left_out > 0 else ""
    before, _, after = entry.subject.partition("''")
    times = f"({found.count} times)" if found.count > 1 else ""
    reason = " ".join(filter(None, (entry.reason, times)))
    return ReportEntry(entry.status, before + shown + after, reason)
