"""The folder of a secured server: modes, users, tokens, certificates."""

import sys
import time
from pathlib import Path

import msgspec
import pytest
from cryptography import x509

from zensim.proto.join_tokens import decode_base64, hash_revoked_password, read_join_address
from zensim.proto.security.roles import ROLES, RefusedUser, User
from zensim.sim_server.security import certificates
from zensim.sim_server.security.certificates import (
    RENEWAL_DAYS,
    find_renewal_s,
    has_revoked,
    make_authority,
    make_router_certificate,
)
from zensim.sim_server.security.secure_folder import (
    FIRST_USERS,
    FolderInUse,
    MissingFolder,
    SecureFolder,
    SecureSettings,
    make_public_endpoint,
    open_secure_folder,
    prepare_secure_folder,
    to_secure_endpoint,
)

SETTINGS = SecureSettings("default", 0, "tls/127.0.0.1:7447")
R1 = User("r1", "agent", ("r1",))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SecureFolder:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return prepare_secure_folder(SETTINGS)


def test_folder_is_for_its_user_only(folder: SecureFolder) -> None:
    folder.make_router_config(SETTINGS.endpoint)
    folder.write_token(folder.add([R1])[0], SETTINGS.endpoint)

    modes = {path.name: path.stat().st_mode & 0o777 for path in folder.path.iterdir()}
    assert folder.path.stat().st_mode & 0o777 == 0o700
    assert modes == dict.fromkeys(modes, 0o600)


def test_new_folder_has_a_user_for_each_role_without_robots(folder: SecureFolder) -> None:
    assert {name: one.user.role for name, one in folder.accounts().items()} == {
        name: name for name in FIRST_USERS
    }
    assert set(FIRST_USERS) | {"agent"} == set(ROLES)


def test_folder_stays_the_same_at_the_next_start(folder: SecureFolder) -> None:
    tokens = [folder.make_token(one).write() for one in folder.list_active()]

    again = prepare_secure_folder(SETTINGS)

    assert [again.make_token(one).write() for one in again.list_active()] == tokens
    assert len(set(tokens)) == len(tokens)


def test_missing_folder_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))

    with pytest.raises(MissingFolder):
        open_secure_folder("default")


@pytest.mark.parametrize(
    "user",
    [
        User("operator", "operator"),
        User("server", "operator"),
        User("router", "observer"),
        User("a", "nobody"),
        User("a", "agent"),
        User("a", "observer", ("r1",)),
        User("a/b", "observer"),
        User("*", "observer"),
        User("a", "agent", ("*",)),
        User("a", "agent", ("sim/default",)),
        User("a", "agent", ("@ros2_lv",)),
    ],
)
def test_user_that_cannot_exist_is_refused(folder: SecureFolder, user: User) -> None:
    with pytest.raises(RefusedUser):
        folder.add([user])


def test_revoked_and_expired_users_are_not_found(folder: SecureFolder) -> None:
    folder.add([R1])
    folder.add([User("soon", "observer")], ttl_s=1e-6)
    assert folder.find_user("r1") == R1

    folder.revoke("r1")

    assert folder.find_user("r1") is None
    assert folder.find_user("soon") is None
    assert "soon" not in {one.user.name for one in folder.list_active()}
    with pytest.raises(RefusedUser):
        folder.revoke("r1")


def test_router_certificate_lists_revoked_and_expired_passwords(folder: SecureFolder) -> None:
    former = (folder.path / "router.pem").read_bytes()
    gone = folder.add([R1])[0]
    folder.add([User("soon", "observer")], ttl_s=1e-6)
    folder.revoke("r1")

    folder.make_router_config(SETTINGS.endpoint)
    made = (folder.path / "router.pem").read_bytes()
    folder.make_router_config(SETTINGS.endpoint)

    assert made != former
    assert (folder.path / "router.pem").read_bytes() == made
    assert has_revoked(made, folder.list_revoked())
    assert len(folder.list_revoked()) == 2
    assert hash_revoked_password(decode_base64(gone.password)) in folder.list_revoked()


def test_token_has_a_certificate_where_the_server_asks_for_one(folder: SecureFolder) -> None:
    folder.write_settings(msgspec.structs.replace(SETTINGS, uses_certificates=True))
    account = folder.add([R1], ttl_s=60.0)[0]

    token = folder.make_token(account)

    certificate = x509.load_der_x509_certificate(token.certificate)
    assert certificate.subject.rfc4514_string() == "CN=r1"
    assert certificate.not_valid_after_utc.timestamp() <= account.expires_s
    security = folder.make_router_config(SETTINGS.endpoint).router_security
    assert security is not None
    assert security.client_authority == str(folder.path / "ca.pem")
    subjects = security.access_control["subjects"]
    assert {"id": "r1", "usernames": ["r1"], "cert_common_names": ["r1"]} in subjects  # type: ignore[operator]


def test_change_of_another_process_is_read(folder: SecureFolder) -> None:
    assert folder.find_user("r1") is None

    SecureFolder(folder.path).add([R1], ttl_s=60.0)

    assert folder.find_user("r1") == R1
    assert folder.accounts()["r1"].expires_s > time.time()


def test_ensured_users_keep_their_passwords(folder: SecureFolder) -> None:
    first = folder.ensure([R1])

    assert folder.ensure([R1]) == first
    assert folder.ensure([User("r1", "agent", ("r1", "r2"))]) != first


def test_token_file_is_a_join_address(folder: SecureFolder) -> None:
    account = folder.accounts()["observer"]

    token = read_join_address(folder.write_token(account, "tls/127.0.0.1:7447"))

    assert token == folder.make_token(account)
    assert token.password_text == account.password


def test_router_admits_the_active_users(folder: SecureFolder) -> None:
    folder.add([R1])
    config = folder.make_router_config(SETTINGS.endpoint)
    lines = (folder.path / "passwords").read_text().splitlines()

    assert {line.split(":")[0] for line in lines} == {*FIRST_USERS, "r1", "server"}
    assert config.router_security is not None
    assert config.router_security.access_control["default_permission"] == "deny"


def test_secrets_are_not_in_representations(folder: SecureFolder) -> None:
    account = folder.accounts()["operator"]
    config = folder.make_server_config(SETTINGS.endpoint)

    assert account.password not in repr(account)
    assert config.credentials is not None
    assert config.credentials.password not in repr(config)


def test_endpoints_are_for_tls() -> None:
    assert to_secure_endpoint("tcp/0.0.0.0:1") == "tls/0.0.0.0:1"
    assert make_public_endpoint("tls/0.0.0.0:1", "sim.example.org") == "tls/sim.example.org:1"
    assert make_public_endpoint("tls/127.0.0.1:1") == "tls/127.0.0.1:1"
    assert "0.0.0.0" not in make_public_endpoint("tls/0.0.0.0:1")
    with pytest.raises(ValueError, match="TLS"):
        to_secure_endpoint("quic/0.0.0.0:1")


def test_certificate_is_renewed_before_it_expires() -> None:
    authority = make_authority("default")

    for days in (RENEWAL_DAYS - 1, RENEWAL_DAYS + 1):
        made = make_router_certificate(authority, days=days).certificate
        assert (find_renewal_s(made) <= time.time()) is (days < RENEWAL_DAYS)


def test_later_start_parses_no_certificate(
    folder: SecureFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    former = (folder.path / "router.pem").read_bytes()
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "zensim.sim_server.security.certificates", None)
        patch.delattr("zensim.sim_server.security.certificates")
        prepare_secure_folder(SETTINGS).make_router_config(SETTINGS.endpoint)

    assert (folder.path / "router.pem").read_bytes() == former


def test_router_certificate_that_is_due_or_replaced_is_made_anew(folder: SecureFolder) -> None:
    router = folder.path / "router.pem"
    authority = certificates.CertifiedKey(
        (folder.path / "ca.pem").read_bytes(), (folder.path / "ca.key").read_bytes()
    )
    soon = make_router_certificate(authority, days=RENEWAL_DAYS - 1).certificate
    router.write_bytes(soon)

    prepare_secure_folder(SETTINGS)

    assert router.read_bytes() != soon
    assert find_renewal_s(router.read_bytes()) > time.time()


def test_change_of_users_waits_until_the_router_admits_them(folder: SecureFolder) -> None:
    assert folder.wait_until_admitted()

    with folder.routing():
        assert not folder.wait_until_admitted(0.0)
        folder.note_admitted(folder.list_active())
        assert folder.wait_until_admitted(0.0)
        folder.add([R1])
        assert not folder.wait_until_admitted(0.0)
        folder.note_admitted(folder.list_active())
        assert folder.wait_until_admitted(0.0)
        folder.forget_admitted()
        assert not folder.wait_until_admitted(0.0)


def test_folder_has_one_router(folder: SecureFolder) -> None:
    with (
        folder.routing(),
        pytest.raises(FolderInUse),
        SecureFolder(folder.path).routing(timeout_s=0.0),
    ):
        pass

    assert prepare_secure_folder(SETTINGS).settings == SETTINGS
