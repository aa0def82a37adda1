"""The file of the audit: a line for each record, a bounded size, an owner."""

import json
import logging
from pathlib import Path

import pytest

from zensim.proto.messages.telemetry_messages import AuditRecord
from zensim.sim_server.security.audit_file import NAME, AuditFile, write_audit_line

RECORD = AuditRecord(action="joined", user="anna", time_ns=1_700_000_000_123_000_000)


def lines_of(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_each_record_is_a_line_for_the_owner_only(tmp_path: Path) -> None:
    for _ in range(2):
        file = AuditFile(tmp_path)
        file.keep(RECORD)
        file.keep(AuditRecord(action="refused", subject="a\nb"))
        file.close()

    found = lines_of(tmp_path / NAME)
    assert [one["action"] for one in found] == ["joined", "refused"] * 2
    assert (found[0]["time"], found[0]["user"]) == ("2023-11-14T22:13:20.123Z", "anna")
    assert found[1]["subject"] == "a\nb"
    assert (tmp_path / NAME).stat().st_mode & 0o777 == 0o600


def test_file_is_replaced_when_it_is_full(tmp_path: Path) -> None:
    size = len(write_audit_line(RECORD))
    for _ in range(7):
        file = AuditFile(tmp_path, max_bytes=2 * size)
        file.keep(RECORD)
        file.close()

    assert len(lines_of(tmp_path / NAME)) == 1
    assert len(lines_of(tmp_path / f"{NAME}.1")) == 2
    assert len([*tmp_path.iterdir()]) == 2


def test_disk_that_refuses_is_reported_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / NAME).mkdir()

    with caplog.at_level(logging.WARNING):
        file = AuditFile(tmp_path, max_bytes=0)
        for _ in range(2000):
            file.keep(RECORD)
        file.close()

    assert len(caplog.records) == 1
