"""Models of the entities of a recording, as its attached files have them."""

from collections.abc import Iterator, Sequence
from itertools import islice, pairwise
from typing import Final

import msgspec

from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.recording.entity_files import MODELS_FOLDER
from zensim.recording.file_index import AttachmentPlace
from zensim.recording.mcap_records import MalformedRecord
from zensim.recording.recording_reader import RecordingReader

MAX_DIGITS: Final = 20
"""Most digits of the number in the name of a file with models."""
MAX_FILES: Final = 16
"""Files that are read for the entities of one snapshot."""
MAX_BYTES: Final = 32 << 20
"""Largest file with models: some 100,000 entities."""
MAX_KEPT: Final = 32
"""Files that are kept in memory."""


class RecordedModels:
    """Finds the models of the entities of a snapshot by its run and roster."""

    def __init__(self, reader: RecordingReader) -> None:
        """List the files; none is read yet."""
        self._reader = reader
        self._servers = [list_rosters(run.attachments) for run in reader.runs]
        self._kept: dict[tuple[int, int], GetModelsResponse | None] = {}

    @property
    def has_any(self) -> bool:
        """Whether there is a file with models."""
        return any(self._servers)

    def find(self, run: int, roster: int, names: Sequence[str]) -> GetModelsResponse:
        """Find the models of entities.

        A file is written when an entity has come, not when one is gone. So an entity is what the
        last file up to the roster says; what came since is in the next one.

        Args:
            run: Number of the run of a snapshot.
            roster: Of the snapshot.
            names: Its entities.

        Raises:
            MalformedRecord: No file can be read.
        """
        found: GetModelsResponse | None = None
        for other in islice(self._list_nearest(run, roster), MAX_FILES):
            one = self._read(run, other)
            if one is not None:
                found = one if found is None else add_missing(found, one, names)
            if found is not None and {*names} <= {member.entity for member in found.entities}:
                break
        if found is None:
            raise MalformedRecord("the models of the recording are malformed")
        return found

    def _list_nearest(self, run: int, roster: int) -> Iterator[int]:
        """List the rosters of files: the last one up to a roster, the next one, and the others."""
        for rosters in reversed(self._servers[run] or next(filter(None, self._servers))):
            before = [one for one in reversed(rosters) if one <= roster]
            after = [one for one in rosters if one > roster]
            yield from (*before[:1], *after[:1], *before[1:], *after[1:])

    def _read(self, run: int, roster: int) -> GetModelsResponse | None:
        """Read a file; None if it is malformed, or too large."""
        if (run, roster) not in self._kept:
            if len(self._kept) >= MAX_KEPT:
                self._kept.clear()
            self._kept[run, roster] = self._decode(run, f"{MODELS_FOLDER}{roster}.json")
        return self._kept[run, roster]

    def _decode(self, run: int, name: str) -> GetModelsResponse | None:
        source = self._reader.runs[run] if self._servers[run] else self._reader
        try:
            return msgspec.json.decode(source.read_attachment(name), type=GetModelsResponse)
        except (MalformedRecord, KeyError, OSError, ValueError, RecursionError):
            return None


def list_rosters(attachments: Sequence[AttachmentPlace]) -> list[list[int]]:
    """List the rosters of files with models, sorted, for each server that wrote some.

    A file of a recording begins with the attachments of the one before it. A server that is
    started again counts from 0.
    """
    names = [
        place.name.removeprefix(MODELS_FOLDER).removesuffix(".json")
        for place in attachments
        if place.name.startswith(MODELS_FOLDER) and place.length <= MAX_BYTES
    ]
    # Python converts no number of thousands of digits.
    rosters = [int(name) for name in names if name.isdecimal() and len(name) <= MAX_DIGITS]
    starts = [number for number, (a, b) in enumerate(pairwise(rosters), 1) if b < a]
    parts = [rosters[a:b] for a, b in pairwise((0, *starts, len(rosters)))]
    return [sorted({*part}) for part in parts if part]


def add_missing(
    found: GetModelsResponse, other: GetModelsResponse, names: Sequence[str]
) -> GetModelsResponse:
    """Add the entities of these names that only the other response has, with its models."""
    missing = {*names} - {member.entity for member in found.entities}
    first = len(found.models)
    added = [
        msgspec.structs.replace(member, model=first + member.model)
        for member in other.entities
        if member.entity in missing
    ]
    if not added:
        return found
    return msgspec.structs.replace(
        found, entities=(*found.entities, *added), models=(*found.models, *other.models)
    )
