"""Limits that a user would notice: the tables of docs/limits.md, by benchmark and figure."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import TypeVar

import msgspec

from benchmarks.figures import Figure, Limit
from benchmarks.machine import ROOT
from benchmarks.measured_page import read_sections, read_tables

PAGE = ROOT / "docs" / "limits.md"
Row = TypeVar("Row")


class NoticedLimit(msgspec.Struct, frozen=True):
    """A limit, why a user would notice, and the cause if it is missed; empty = it is met."""

    limit: Limit
    why: str
    cause: str


@cache
def read_limits() -> Mapping[str, Mapping[str, NoticedLimit]]:
    """Read all limits, by benchmark and by figure with its unit."""
    sections = read_sections(PAGE.read_text(encoding="utf-8"))
    return {name: dict(_read_section(section)) for name, section in sections.items()}


def judge(name: str, rows: Iterable[Row]) -> Iterator[Row]:
    """Give the figures of a benchmark their limits; other rows stay as they are."""
    limits = read_limits().get(name, {})
    for row in rows:
        if isinstance(row, Figure) and str(row) in limits:
            yield msgspec.structs.replace(row, limit=limits[str(row)].limit)
        else:
            yield row


def _read_section(section: str) -> Iterator[tuple[str, NoticedLimit]]:
    for _, *rows in read_tables(section):
        for figure, asked, why, cause in rows:
            yield figure, NoticedLimit(Limit.parse(asked), why, cause)
