"""Recordings that commands read, with notes of what is not read."""

from collections.abc import Collection, Iterable
from pathlib import Path

from zensim.proto.verbosity import print_note
from zensim.recording.recording_parts import METADATA_FILE, list_further_files, list_missing_files
from zensim.recording.recording_reader import RecordingReader


def open_recording(command: str, path: Path, others: Collection[Path] = ()) -> RecordingReader:
    """Open a recording; see `note_unread`.

    Raises:
        OSError: It cannot be read.
        ValueError: It is not a recording.
    """
    reader = RecordingReader(path)
    note_unread(command, path, map(str, reader.unclosed), others)
    return reader


def note_unread(
    command: str, path: Path, unclosed: Iterable[str], others: Collection[Path] = ()
) -> None:
    """Note files that were never closed, are missing, or are further ones not among others."""
    for file in unclosed:
        print_note(command, f"{file} was never closed, and is read in whole; 'zensim bag recover'")
    if missing := list_missing_files(path):
        print_note(command, f"{path / METADATA_FILE} names {', '.join(missing)}: not in the folder")
    if further := [one for one in list_further_files(path) if one not in others]:
        names = further[0].name + (f" to {further[-1].name}" if len(further) > 1 else "")
        what_to_do = "'zensim bag convert' joins files"
        print_note(command, f"more of this recording is in {names}; {what_to_do}")


def note_damage(command: str, damaged: int) -> None:
    """Note places that could not be read."""
    if damaged:
        print_note(command, f"{damaged} damaged places of the recording were left out")
