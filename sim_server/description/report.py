"""The effect of each tag of a description, collected during parsing."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches

from zensim.proto.messages.model_messages import ReportEntry, ReportStatus

MAX_ENTRIES = 200
"""Without suspicious ones."""
MAX_SUSPICIOUS_ENTRIES = 600
"""More than one per link of the largest robot, so that no missing mesh is left out."""
MAX_NAMES = 3
"""Named by an entry that stands for several links, joints or plug-ins."""
GROUPED: frozenset[ReportStatus] = frozenset({"ignored", "unknown"})
_QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
_NUMBER = re.compile(r"(?<=, visual) \d+|(?<=, collision) \d+")


@dataclass
class _Occurrences:
    """How often an entry occurred, and the names that differ."""

    count: int = 0
    names: dict[str, None] = field(default_factory=dict)


class ParseReport:
    """Different entries in order; entries beyond the maximum are only counted.

    Ignored and unknown entries that differ only in the first quoted name, such as that of a link,
    are one entry, which has their number and three of the names.
    """

    def __init__(self) -> None:
        self._entries: dict[ReportEntry, _Occurrences] = {}
        self._suspicious = 0
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
        self._add(entry.status, f"{of}: {entry.subject}", entry.reason)

    def unread_tag(self, subject: str, tag: str, known: Iterable[str]) -> None:
        """Report an unknown tag; as suspicious if its name resembles a known one."""
        shown = f"{subject}: <{tag[:80]}>"
        if not self._has_room("unknown"):
            # The comparison is slow: a hostile file could have many unknown tags.
            self._left_out += 1
            return
        key = (tag, tuple(known))
        if key not in self._similar:
            self._similar[key] = get_close_matches(*key, n=1, cutoff=0.75)
        if similar := self._similar[key]:
            self.suspicious(shown, f"not read; did you mean <{similar[0]}>?")
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
        name = _QUOTED.search(subject) if status in GROUPED else None
        if name is None:
            entry = ReportEntry(status, subject, reason)
        else:
            rest = _NUMBER.sub("", subject[name.end() :])
            entry = ReportEntry(status, f"{subject[: name.start()]}''{rest}", reason)
        if entry not in self._entries and not self._has_room(status):
            self._left_out += 1
            return
        found = self._entries.setdefault(entry, _Occurrences())
        if name is not None:
            found.count += 1
            found.names[name.group()] = None
        self._suspicious += status == "suspicious" and found.count == 0
        found.count = max(found.count, 1)

    def _has_room(self, status: ReportStatus) -> bool:
        if status == "suspicious":
            return self._suspicious < MAX_SUSPICIOUS_ENTRIES
        return len(self._entries) - self._suspicious < MAX_ENTRIES


def _describe(entry: ReportEntry, found: _Occurrences) -> ReportEntry:
    if not found.names:
        return entry
    names = list(found.names)
    shown, left_out = ", ".join(names[:MAX_NAMES]), len(names) - MAX_NAMES
    shown += f" and {left_out} more" if left_out > 0 else ""
    before, _, after = entry.subject.partition("''")
    times = f" ({found.count} times)" if found.count > 1 else ""
    return ReportEntry(entry.status, before + shown + after, entry.reason + times)
