"""Sessions with a secured server, from the links of its router and the tokens of their users."""

import pytest

from zensim.sim_server.security.user_sessions import (
    MAX_WAITING,
    UNNAMED_AFTER_S,
    SessionChange,
    UserSessions,
)

ADDRESS = "tls/10.0.0.1:7"
JOINED = SessionChange(action="joined", user="anna", address=ADDRESS)
LEFT = SessionChange(action="left", user="anna", address=ADDRESS)


def link(sessions: UserSessions, session: str = "s", *, is_open: bool = True) -> None:
    sessions.note_link(session, ADDRESS, is_open=is_open, now_s=0.0)


def name(sessions: UserSessions, session: str = "s", *, user: str = "anna") -> None:
    sessions.note_user(session, user, is_alive=True)


@pytest.mark.parametrize("steps", [(link, name), (name, link)])
def test_session_joins_when_link_and_user_are_known(steps: tuple[object, ...]) -> None:
    sessions = UserSessions("own")
    first, second = steps
    assert callable(first)
    assert callable(second)

    first(sessions)
    assert sessions.take(0.0) == []
    second(sessions)

    assert sessions.take(0.0) == [JOINED]
    sessions.note_user("s", "anna", is_alive=False)
    link(sessions, is_open=False)
    assert sessions.take(0.0) == [LEFT]


def test_session_that_names_no_user_joins_without_one() -> None:
    sessions = UserSessions("own")
    link(sessions)

    assert sessions.take(UNNAMED_AFTER_S / 2) == []
    found = sessions.take(UNNAMED_AFTER_S)

    assert found == [SessionChange(action="joined", user="", address=ADDRESS)]
    assert sessions.find_address("s", "anna") == ADDRESS


def test_session_that_ends_at_once_joined_and_left() -> None:
    sessions = UserSessions("own")
    name(sessions)
    sessions.note_user("s", "anna", is_alive=False)
    link(sessions)
    link(sessions, is_open=False)

    assert sessions.take(0.0) == [JOINED, LEFT]


def test_session_that_is_linked_again_left_and_joined() -> None:
    sessions = UserSessions("own")
    name(sessions)
    link(sessions)
    sessions.take(0.0)
    sessions.note_link("s", "tls/10.0.0.2:8", is_open=True, now_s=0.0)
    link(sessions, is_open=False)

    assert sessions.take(0.0) == [LEFT]
    assert sessions.find_address("s", "anna") == "tls/10.0.0.2:8"


def test_session_of_another_user_gives_no_address() -> None:
    sessions = UserSessions("own")
    link(sessions)
    name(sessions)
    name(sessions, user="eve")

    assert sessions.find_address("s", "anna") == ADDRESS
    assert sessions.find_address("s", "eve") == ""
    assert sessions.find_address("s", "") == ADDRESS
    assert sessions.find_address("other", "eve") is None


def test_own_session_is_not_reported() -> None:
    sessions = UserSessions("own")
    link(sessions, "own")

    assert sessions.take(UNNAMED_AFTER_S) == []


def test_users_of_sessions_without_links_are_bounded() -> None:
    sessions = UserSessions("own")
    for number in range(MAX_WAITING + 1):
        name(sessions, str(number), user="eve")

    for session in ("0", "1"):
        link(sessions, session)

    assert [one.user for one in sessions.take(0.0)] == ["eve"]
