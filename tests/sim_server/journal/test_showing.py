"""Showing: a journal for people, and all of it for programs."""

import json
from pathlib import Path

from tests.sim_server.journal.stage import Journalled
from zensim.sim_server.journal.ledger import open_ledger
from zensim.sim_server.journal.restoring import contents_of, seal
from zensim.sim_server.journal.rows import AsideRow
from zensim.sim_server.journal.showing import exported, page, summary


def test_page_lists_entities_and_who_is_set_aside(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0", "r1")
    kept.recorder.note()
    contents = contents_of(kept.ledger)
    assert contents is not None
    seal(kept.ledger, [AsideRow(entity=contents.entities[1], reason="it kills")])

    shown = page(summary(kept.ledger, contents_of(kept.ledger)))

    assert "entities: 1\n  r0  ns=r0  model=cart  at 0.000 0.000 0.050\n" in shown
    assert shown.endswith("set aside: 1\n  r1: it kills")


def test_export_holds_descriptions_and_is_json(tmp_path: Path) -> None:
    kept = Journalled(tmp_path, "r0")
    kept.recorder.note()

    found = json.loads(json.dumps(exported(kept.ledger, contents_of(kept.ledger))))

    assert found["descriptions"] == {"r0": "<robot/>"}
    assert found["entities"][0]["joints"] == {"right_joint": 0.0, "left_joint": 0.0}
    assert found["world_source"]["name"] == "default"


def test_journal_that_was_just_begun_is_shown_as_empty(tmp_path: Path) -> None:
    ledger = open_ledger(tmp_path)

    assert page(summary(ledger, contents_of(ledger))).endswith("entities: 0\nset aside: 0")
    assert exported(ledger, None)["entities"] == []
