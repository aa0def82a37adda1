"""`zensim view` without its packages, and where and for whom it serves."""

import stat
import subprocess
import sys
from pathlib import Path

import pytest

from zensim.proto.endpoints import Exposed
from zensim.spawner.cli.view_commands import (
    check_certificate,
    check_page_exposure,
    make_page_url,
    read_page_token,
)

WITHOUT_VISER = """
import sys
sys.modules["viser"] = None
sys.argv = ["zensim", "view"]
from zensim.deploy.cli import main
main()
"""


def test_view_names_the_extra_when_viser_is_not_installed() -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_VISER],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )

    assert done.returncode == 1
    assert done.stdout == ""
    assert "pip install 'zensim[viewer]'" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "sim.lab"])
def test_page_for_other_hosts_is_refused_without_a_decision(host: str) -> None:
    with pytest.raises(Exposed, match="--secure --certificate FILE --key FILE"):
        check_page_exposure(host, has_tls=False, is_secure=False, is_insecure=False)
    with pytest.raises(Exposed, match="--certificate FILE"):
        check_page_exposure(host, has_tls=False, is_secure=True, is_insecure=False)

    check_page_exposure(host, has_tls=True, is_secure=True, is_insecure=False)
    check_page_exposure(host, has_tls=False, is_secure=False, is_insecure=True)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
@pytest.mark.parametrize("is_secure", [False, True])
def test_page_on_loopback_needs_no_decision(host: str, *, is_secure: bool) -> None:
    check_page_exposure(host, has_tls=False, is_secure=is_secure, is_insecure=False)


def test_decisions_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="--insecure"):
        check_page_exposure("::", has_tls=True, is_secure=True, is_insecure=True)


@pytest.mark.parametrize("files", [(Path("a"), None), (None, Path("a"))])
def test_certificate_and_key_belong_together(files: tuple[Path | None, Path | None]) -> None:
    with pytest.raises(ValueError, match="--certificate and --key"):
        check_certificate(*files)


def test_token_is_made_once_and_kept_for_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "page.token"

    first, again = read_page_token(path), read_page_token(path)

    assert first == again
    assert len(first) >= 22
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert read_page_token(None) != read_page_token(None)


def test_file_without_a_token_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "page.token"
    path.write_text("short")

    with pytest.raises(ValueError, match=r"page\.token"):
        read_page_token(path)


@pytest.mark.parametrize(
    ("host", "token", "has_tls", "url"),
    [
        ("127.0.0.1", "", False, "http://127.0.0.1:80"),
        ("0.0.0.0", "t", False, "http://127.0.0.1:80/?zensim_token=t"),
        ("::", "t", True, "https://[::1]:80/?zensim_token=t"),
    ],
)
def test_address_has_the_token(host: str, token: str, url: str, *, has_tls: bool) -> None:
    assert make_page_url(host, 80, token, has_tls=has_tls) == url
