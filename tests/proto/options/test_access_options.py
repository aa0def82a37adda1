"""The address of a page has its token on a terminal only."""

import sys
from pathlib import Path

import pytest

from zensim.proto.options.access_options import AccessOptions
from zensim.proto.web_access import make_page_url

URL = make_page_url("127.0.0.1", 8080, "secret", has_tls=False)


def test_terminal_shows_the_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)

    assert URL in AccessOptions(secure=True).write_address("viewer", URL)


def test_log_names_the_file_of_the_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    text = AccessOptions(secure=True).write_address("viewer", URL)

    (file,) = (one for one in tmp_path.rglob("*") if one.is_file())
    assert "secret" not in text.replace(str(file), "")
    assert f"/?zensim_token=$(cat {file})" in text
    assert file.read_text() == "secret"


def test_log_names_the_file_that_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    given = tmp_path / "page.token"

    text = AccessOptions(secure=True, page_token=given).write_address("viewer", URL)

    assert str(given) in text
    assert list(tmp_path.iterdir()) == []


def test_page_without_a_token_has_its_whole_address() -> None:
    url = make_page_url("127.0.0.1", 8080, "", has_tls=False)

    assert AccessOptions().write_address("viewer", url) == f"viewer {url}"
