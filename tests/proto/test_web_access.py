"""Who may open a server for browsers: origin, token, certificate, other hosts."""

import socket
import stat
from pathlib import Path

import pytest

from zensim.proto.endpoints import Exposed
from zensim.proto.web_access import (
    check_certificate,
    check_page_exposure,
    has_token,
    has_token_in_address,
    is_own_origin,
    keep_token,
    make_page_url,
    name_cookie,
    read_page_token,
    remove_token,
    split_token,
)

OWN = socket.gethostname().lower()


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:8080", "http://127.0.0.1:8080"),
        ("localhost:9000", "http://localhost:9000"),
        ("[::1]:8080", "http://[::1]:8080"),
        ("192.168.1.5:8080", "http://192.168.1.5:8080"),
        (f"{OWN}:8080", f"http://{OWN}:8080"),
        ("sim.lab:8080", "http://sim.lab:8080"),
        ("SIM.lab:8080", "http://sim.LAB:8080"),
        ("127.0.0.1:8080", ""),
        ("server:9464", ""),
    ],
)
def test_request_of_the_own_page_is_accepted(host: str, origin: str) -> None:
    assert is_own_origin([host], [origin] if origin else [], bound_to="sim.lab")


@pytest.mark.parametrize(
    ("hosts", "origins"),
    [
        (["127.0.0.1:8080"], ["http://evil.example"]),
        (["127.0.0.1:8080"], ["http://127.0.0.1:3000"]),
        (["127.0.0.1:8080"], ["null"]),
        (["127.0.0.1:8080"], ["http://[::1"]),
        (["127.0.0.1:8080"], ["http://127.0.0.1:8080", "http://evil.example"]),
        (["evil.example:8080"], ["http://evil.example:8080"]),
        (["evil.example:8080"], []),
        (["127.0.0.1:8080; script-src *"], []),
        (["127.0.0.1:8080", "evil.example"], []),
        ([""], []),
        ([], []),
    ],
)
def test_request_of_another_page_is_refused(hosts: list[str], origins: list[str]) -> None:
    assert not is_own_origin(hosts, origins, bound_to="127.0.0.1")


@pytest.mark.parametrize(
    ("hosts", "is_admitted"), [(["127.0.0.1:8765"], True), (["evil.example:8765"], False)]
)
def test_admitted_origin_is_accepted_at_a_name_of_this_host_only(
    hosts: list[str], *, is_admitted: bool
) -> None:
    origins = ["https://app.example"]

    assert is_own_origin(hosts, origins, bound_to="::1", admitted=origins) == is_admitted
    assert not is_own_origin(hosts, ["https://b.example"], bound_to="::1", admitted=origins)


@pytest.mark.parametrize(
    ("cookies", "is_known"),
    [
        (["zensim_token_80=s"], True),
        (["a=b; zensim_token_80=s"], True),
        (["a=b", "zensim_token_80=s"], True),
        (["zensim_token_80=S"], False),
        (["zensim_token_80="], False),
        (["zensim_token_81=s"], False),
        (["token=s"], False),
        (["zensim_token_80=s\u00e9"], False),
        ([], False),
    ],
)
def test_cookie_of_a_port_has_the_token(cookies: list[str], *, is_known: bool) -> None:
    assert has_token(cookies, name_cookie(80), "s") == is_known


@pytest.mark.parametrize(
    ("path", "is_known"),
    [("/?zensim_token=s", True), ("/?a=b&zensim_token=s", True), ("/", False), ("//[", False)],
)
def test_address_that_is_opened_has_the_token(path: str, *, is_known: bool) -> None:
    assert has_token_in_address(path, "s") == is_known


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "sim.lab"])
def test_page_for_other_hosts_is_refused_without_a_decision(host: str) -> None:
    with pytest.raises(Exposed, match="--secure --certificate FILE --key FILE"):
        check_page_exposure("zensim view", host, has_tls=False, is_secure=False, is_insecure=False)
    with pytest.raises(Exposed, match="`certificate`"):
        check_page_exposure("zensim view", host, has_tls=False, is_secure=True, is_insecure=False)

    check_page_exposure("zensim view", host, has_tls=True, is_secure=True, is_insecure=False)
    check_page_exposure("zensim view", host, has_tls=False, is_secure=False, is_insecure=True)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
@pytest.mark.parametrize("is_secure", [False, True])
def test_page_on_loopback_needs_no_decision(host: str, *, is_secure: bool) -> None:
    check_page_exposure("zensim view", host, has_tls=False, is_secure=is_secure, is_insecure=False)


def test_decisions_exclude_each_other() -> None:
    with pytest.raises(ValueError, match="`insecure`"):
        check_page_exposure("zensim view", "::", has_tls=True, is_secure=True, is_insecure=True)


@pytest.mark.parametrize("files", [(Path("a"), None), (None, Path("a"))])
def test_certificate_and_key_belong_together(files: tuple[Path | None, Path | None]) -> None:
    with pytest.raises(ValueError, match="`certificate` and `key`"):
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


@pytest.mark.parametrize(
    ("path", "kept"),
    [
        ("/?zensim_token=a", "/"),
        ("/", "/"),
        ("/?robot=r1&zensim_token=a&theme=dark", "/?robot=r1&theme=dark"),
        ("/?robot=%0d%0aSet-Cookie:%20a&zensim_token=a", "/?robot=%0D%0ASet-Cookie%3A+a"),
        ("//evil.example/?zensim_token=a&robot=r1", "/?robot=r1"),
        ("//[::1/?zensim_token=a", "/"),
    ],
)
def test_an_address_without_the_secret_keeps_the_rest(path: str, kept: str) -> None:
    assert remove_token(path) == kept


@pytest.mark.parametrize("token", ["", "secret"])
def test_address_is_split_into_page_and_token(token: str) -> None:
    url = make_page_url("127.0.0.1", 80, token, has_tls=True)

    assert split_token(url)[1] == token
    assert split_token(url)[0].rstrip("/") == "https://127.0.0.1:80"


def test_token_is_kept_for_its_owner_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    files = [keep_token(token, "viewer-80") for token in ("former", "secret")]

    assert files[0] == files[1]
    assert files[1].read_text() == "secret"
    assert stat.S_IMODE(files[1].stat().st_mode) == 0o600
