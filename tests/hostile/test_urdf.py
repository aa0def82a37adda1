"""Hostile descriptions are parsed or refused with a slug, in one line and in time."""

import socket
import time

import pytest

from tests.hostile.case import Case
from tests.hostile.corpus import corpus
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError

CASES = corpus()
LONGEST_MESSAGE = 600
LONGEST_S = 5.0


def refusal_of(text: str) -> ModelError | None:
    try:
        read_urdf(text)
    except ModelError as refusal:
        return refusal
    return None


def test_corpus_is_large_and_names_each_case_once() -> None:
    names = [case.name for case in CASES]

    assert len(names) >= 150
    assert sorted(set(names)) == sorted(names)


@pytest.mark.parametrize("case", CASES, ids=lambda case: ascii(case.name))
def test_description_is_refused_with_its_slug(case: Case) -> None:
    started = time.thread_time()

    refusal = refusal_of(case.text)

    assert time.thread_time() - started < LONGEST_S
    assert (refusal.slug if refusal else "") == case.slug


def test_refusals_are_one_line_of_limited_length() -> None:
    for case in CASES:
        if refusal := refusal_of(case.text):
            assert refusal.message.startswith(f"{case.slug}: "), case.name
            assert "\n" not in refusal.message, case.name
            assert len(refusal.message) <= LONGEST_MESSAGE, case.name


def test_parsing_opens_no_socket_and_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(socket, "socket", lambda *_: opened.append("socket"))
    monkeypatch.setattr("builtins.open", lambda name, *_, **__: opened.append(str(name)))

    for case in CASES:
        if len(case.text) < 100_000:
            refusal_of(case.text)

    assert opened == []
