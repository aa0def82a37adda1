"""The viewer page on a real port, without a browser."""

import datetime
import ssl
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from ipaddress import ip_address
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import urlsplit

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from tests.fakes import MemoryBus
from tests.integration.page_client import (
    PageVisitor,
    connect_page,
    encode_act,
    encode_camera,
    encode_click,
    encode_share_request,
    encode_update,
    find_control,
    read_messages,
)
from tests.integration.page_user import PageUser
from tests.integration.processes import eventually
from tests.spawner.page.builders import make_models_by_name, make_robot, make_snapshot, make_wall
from zensim.proto.messages.model_messages import Shape
from zensim.proto.web_access import CannotListen, PageAccess, PortTaken, name_cookie
from zensim.spawner.page.page_server import MAX_MESSAGE_BYTES, MAX_VISITORS
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    make_fleet,
    make_frame,
)
from zensim.spawner.page.robot_driver import RobotDriver
from zensim.spawner.page.shortcuts import SHORTCUTS
from zensim.spawner.page.side_panel import RED
from zensim.spawner.page.viewer_page import TEXT_PERIOD_S, ViewerPage

TOKEN, OTHER_TOKEN = "7f3a-page", "9c1e-page"
STATUS = SimulationStatus("playing", 1.0, 1.0, robots=2, entities=3)


@pytest.fixture
def driver() -> Iterator[RobotDriver]:
    with closing(RobotDriver(MemoryBus())) as found:
        yield found


@pytest.fixture
def page(driver: RobotDriver) -> Iterator[ViewerPage]:
    with closing(ViewerPage("127.0.0.1", 0, driver=driver)) as found:
        yield found


@pytest.fixture
def page_with_token(driver: RobotDriver) -> Iterator[ViewerPage]:
    with closing(ViewerPage("127.0.0.1", 0, PageAccess(TOKEN), driver)) as found:
        yield found


@pytest.fixture
def visitor(page: ViewerPage) -> Iterator[ClientConnection]:
    with closing(connect_page(url_of(page))) as connection:
        connection.send(encode_camera())
        wait_until(page, is_watched=True)
        yield connection


def url_of(page: ViewerPage) -> str:
    return f"http://127.0.0.1:{page.port}"


def wait_until(page: ViewerPage, *, is_watched: bool) -> None:
    def look() -> bool:
        page.wait_for_input(0.01)
        return page.is_watched == is_watched

    eventually(look, 5.0, f"is_watched == {is_watched}")


def wait_until_followed(page: ViewerPage, *names: str) -> None:
    def look() -> bool:
        page.wait_for_input(0.01)
        return page.selected == set(names)

    eventually(look, 5.0, f"following {names}")


def a_scene(*names: str) -> tuple[RenderedFleet, RenderedFrame]:
    """Make a scene of robots, and of walls for names that begin with w."""
    kinds = {name: make_wall() if name.startswith("w") else make_robot(name) for name in names}
    fleet = make_fleet(names, make_models_by_name(kinds))
    return fleet, make_frame(fleet, make_snapshot(*names, joints=fleet.joints))


def names_of(page: ViewerPage) -> object:
    with urllib.request.urlopen(f"{url_of(page)}/names") as response:
        return msgspec.json.decode(response.read())


def test_page_is_watched_while_a_client_has_it_open(page: ViewerPage) -> None:
    assert not page.is_watched

    with closing(connect_page(url_of(page))) as connection:
        connection.send(encode_camera())
        wait_until(page, is_watched=True)

    wait_until(page, is_watched=False)


def test_page_sends_names_by_batch(page: ViewerPage) -> None:
    page.show(*a_scene("r1", "w1", "r2"), STATUS, {})

    assert names_of(page) == {"/robots/0": ["r1", "r2"], "/robots/1": ["w1"]}


def test_page_removes_deleted_entities(page: ViewerPage) -> None:
    page.show(*a_scene("r1", "w1", "r2"), STATUS, {})

    page.show(*a_scene("r2"), STATUS, {})

    assert names_of(page) == {"/robots/0": ["r2"]}


def test_robots_have_a_shadow_and_walls_have_none(
    page: ViewerPage, visitor: ClientConnection
) -> None:
    page.show(*a_scene("w1", "r1", "r2"), STATUS, {})

    found: set[str] = set()
    while not {"/robots/0/0/0", "/robots/1/0/0"} <= found:
        found |= {str(one.get("name")) for one in read_messages(visitor.recv(timeout=60.0))}
    shadows = {name for name in found if name.startswith("/shadows/")}
    assert max(shadows) == "/shadows/1/2/0"
    assert not any(name.startswith("/shadows/0") for name in shadows)


@pytest.mark.usefixtures("visitor")
def test_page_follows_no_robot_before_a_click(page: ViewerPage) -> None:
    page.show(*a_scene("r1"), STATUS, {})

    assert page.selected == frozenset()


def test_page_follows_the_clicked_robot_until_it_is_deleted(
    page: ViewerPage, visitor: ClientConnection
) -> None:
    page.show(*a_scene("r1", "r2"), STATUS, {})

    visitor.send(encode_click("/robots/0/0/0", 1))
    wait_until_followed(page, "r2")
    page.show(*a_scene("r1", "r2"), STATUS, {"r2": LastCommand(0.1, 0.2, age_s=0.0)})
    assert page.selected == {"r2"}

    def is_left() -> bool:
        page.show(*a_scene("r1"), STATUS, {})
        return page.selected == frozenset()

    eventually(is_left, 5.0, "leaving")


def test_page_follows_no_robot_when_the_click_hits_none(
    page: ViewerPage, visitor: ClientConnection
) -> None:
    page.show(*a_scene("r1"), STATUS, {})

    visitor.send(encode_click("/robots/0/0/0", 7))
    visitor.send(encode_click("/robots/0/0/0", 0))

    wait_until_followed(page, "r1")


def test_a_click_before_its_page_is_known_has_no_effect(page: ViewerPage) -> None:
    page.show(*a_scene("r1"), STATUS, {})
    page._pick(0, "r1", is_added=False)  # noqa: SLF001  before the event of the connection
    page._pick(0, "r1", is_added=True)  # noqa: SLF001
    with closing(connect_page(url_of(page))) as connection:
        connection.send(encode_camera())
        eventually(lambda: bool(page._server.get_clients()), 5.0, "a client")  # noqa: SLF001

        wait_until(page, is_watched=True)

        assert page.selected == frozenset()


def test_page_keeps_working_when_a_following_client_disconnects(page: ViewerPage) -> None:
    page.show(*a_scene("r1"), STATUS, {})
    with closing(connect_page(url_of(page))) as connection:
        connection.send(encode_camera())
        wait_until(page, is_watched=True)
        connection.send(encode_click("/robots/0/0/0", 0))
        wait_until_followed(page, "r1")

    page.warn("still here")
    page.move_cameras()
    page.show_disconnected()
    wait_until(page, is_watched=False)

    assert page.selected == frozenset()


def test_a_lost_server_stays_shown_when_a_text_was_due(page: ViewerPage) -> None:
    with closing(PageUser(url_of(page))) as user:
        wait_until(page, is_watched=True)
        for _ in range(2):  # the text of the second one is due later
            page.show(*a_scene("r1"), STATUS, {})
        eventually(lambda: STATUS.state in user.texts(), 5.0, "a snapshot")

        page.show_disconnected()
        page.wait_for_input(2.0 * TEXT_PERIOD_S)
        page.move_cameras()
        page.warn("the last")

        eventually(lambda: "the last" in user.notifications, 5.0, "all messages")
        assert STATUS.state not in user.texts()


def test_page_refuses_share_requests(
    page: ViewerPage, visitor: ClientConnection, capfd: pytest.CaptureFixture[str]
) -> None:
    visitor.send(encode_share_request())
    visitor.send(encode_click("/robots/0/0/0", 0))
    page.show(*a_scene("r1"), STATUS, {})
    visitor.send(encode_click("/robots/0/0/0", 0))
    wait_until_followed(page, "r1")

    assert capfd.readouterr() == ("", "")


def wait_for_button(page: ViewerPage) -> list[str]:
    pressed: list[str] = []

    def look() -> bool:
        pressed.extend(one for one in page.wait_for_input(0.01) if isinstance(one, str))
        return bool(pressed)

    eventually(look, 5.0, "a pressed button")
    return pressed


def test_a_page_sets_no_attribute_of_a_control_but_its_value(
    page: ViewerPage, visitor: ClientConnection, capfd: pytest.CaptureFixture[str]
) -> None:
    visitor.send(encode_camera())
    slider = find_control(visitor, "GuiSliderMessage")

    visitor.send(encode_update(slider, update_cb=[]))
    visitor.send(encode_act("Explode"))
    visitor.send(b"\xff" * 9)
    visitor.send("text")
    visitor.send(encode_act("Pause"))

    assert wait_for_button(page) == ["Pause"]
    assert capfd.readouterr() == ("", "")


def test_a_message_above_the_limit_ends_only_its_sender(page: ViewerPage) -> None:
    with closing(connect_page(url_of(page))) as large, closing(connect_page(url_of(page))) as other:
        other.send(encode_camera())
        page.wait_for_input(1.0)
        large.send(encode_camera() + b"\0" * MAX_MESSAGE_BYTES)
        other.send(encode_act("Play"))

        assert wait_for_button(page) == ["Play"]
        with pytest.raises(ConnectionClosed):
            list(large)


def test_a_page_beyond_the_limit_is_refused_until_one_is_closed(page: ViewerPage) -> None:
    with ExitStack() as stack:
        pages = [
            stack.enter_context(closing(connect_page(url_of(page)))) for _ in range(MAX_VISITORS)
        ]
        with pytest.raises(InvalidStatus, match="503"):
            connect_page(url_of(page))

        pages[0].close()

        def is_served() -> bool:
            with suppress(InvalidStatus), closing(connect_page(url_of(page))):
                return True
            return False

        eventually(is_served, 5.0, "a free place")


def test_page_survives_drawing_while_clients_come_and_go(page: ViewerPage) -> None:
    scenes = [a_scene("r1", "w1"), a_scene("r1", "r2", "w1")]
    for number in range(60):
        with closing(connect_page(url_of(page))) as connection:
            connection.send(encode_camera())
            for scene in scenes * 5:
                page.show(*scene, STATUS, {})
                page.wait_for_input(0.0)
        assert names_of(page) == {"/robots/0": ["r1", "r2"], "/robots/1": ["w1"]}, number


def test_page_with_a_token_needs_it_once(page_with_token: ViewerPage) -> None:
    url = url_of(page_with_token)
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())

    for path, reason in (("/", "lacks"), ("/names", "lacks"), ("/?zensim_token=x", "not valid")):
        with pytest.raises(HTTPError, match="401") as refusal:
            opener.open(url + path)
        assert reason in refusal.value.read().decode()
        refusal.value.close()
    with pytest.raises(InvalidStatus, match="401"):
        connect_page(url)
    with opener.open(f"{url}/?zensim_token={TOKEN}") as response:
        assert response.url == f"{url}/"  # the secret has left the address
        assert b"<title>zensim</title>" in response.read()
    with opener.open(f"{url}/names") as response:
        assert response.status == 200
    with closing(connect_page(url, cookie=f"a=b; {cookie_of(url)}")) as connection:
        find_control(connection, "GuiHtmlMessage")


def test_other_methods_than_get_are_refused(page: ViewerPage) -> None:
    for method in ("HEAD", "POST"):
        request = urllib.request.Request(url_of(page), method=method)
        with pytest.raises(HTTPError, match="405") as refusal:
            urllib.request.urlopen(request)
        refusal.value.close()


def cookie_of(url: str) -> str:
    return f"{name_cookie(urlsplit(url).port or 0)}={TOKEN}"


def test_a_browser_has_the_cookies_of_two_pages_of_a_host(page_with_token: ViewerPage) -> None:
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with closing(ViewerPage("127.0.0.1", 0, PageAccess(OTHER_TOKEN))) as other:
        for page, token in ((page_with_token, TOKEN), (other, OTHER_TOKEN)):
            opener.open(f"{url_of(page)}/?zensim_token={token}").close()

        for page in (page_with_token, other):
            with opener.open(f"{url_of(page)}/names") as response:
                assert response.status == 200


class KeepRedirect(urllib.request.HTTPRedirectHandler):
    """Follows no redirection."""

    def redirect_request(self, *_: object) -> None:
        return None


def test_the_cookie_is_sent_for_links_in_mails_and_not_for_requests_of_other_sites(
    page_with_token: ViewerPage,
) -> None:
    url = url_of(page_with_token)
    opener = urllib.request.build_opener(KeepRedirect())

    with pytest.raises(HTTPError, match="303") as answer:
        opener.open(f"{url}/?robot=r1&zensim_token={TOKEN}&theme=dark")

    answer.value.close()
    attributes = {one.strip() for one in answer.value.headers["Set-Cookie"].split(";")}
    assert attributes >= {"HttpOnly", "SameSite=Lax", "Path=/"}
    assert answer.value.headers["Location"] == "/?robot=r1&theme=dark"


def test_the_page_of_another_site_is_refused_even_with_the_cookie(
    page_with_token: ViewerPage,
) -> None:
    url = url_of(page_with_token)

    with pytest.raises(InvalidStatus, match="403"):
        connect_page(url, "http://evil.example", cookie_of(url))


def test_head_connects_until_the_server_is_found_or_missed(
    page: ViewerPage, visitor: ClientConnection
) -> None:
    shown = PageVisitor(visitor)
    eventually(lambda: "connecting" in shown.texts(), 5.0, "the first state")
    assert RED not in shown.texts()

    page.show_disconnected()

    eventually(lambda: "no server" in shown.texts(), 5.0, "the next state")


def read_page(page: ViewerPage) -> str:
    with urllib.request.urlopen(url_of(page)) as response:
        return str(response.read().decode())


def test_help_has_the_keys_that_the_page_has(page: ViewerPage) -> None:
    with closing(ViewerPage("127.0.0.1", 0)) as watching:
        seen, acting = read_page(watching), read_page(page)

    assert [shortcut.what in acting for shortcut in SHORTCUTS] == [True] * len(SHORTCUTS)
    assert not any(one.what in seen for one in SHORTCUTS)


def make_certificate(folder: Path) -> tuple[str, str]:
    """Make a certificate of 127.0.0.1 and its key, signed by itself."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "page")])
    now = datetime.datetime.now(datetime.timezone.utc)
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now)
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    certificate, private_key = folder / "page.pem", folder / "page.key"
    certificate.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    private_key.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return str(certificate), str(private_key)


def test_page_with_a_certificate_is_served_by_https(tmp_path: Path) -> None:
    files = make_certificate(tmp_path)
    trust = ssl.create_default_context(cafile=files[0])
    with closing(ViewerPage("127.0.0.1", 0, PageAccess(TOKEN, *files))) as page:
        opener = urllib.request.build_opener(
            urllib.request.HTTPSHandler(context=trust), urllib.request.HTTPCookieProcessor()
        )
        url = url_of(page).replace("http", "https")
        with opener.open(f"{url}/?zensim_token={TOKEN}") as response:
            assert b"<title>zensim</title>" in response.read()
        with opener.open(f"{url}/names") as response:
            assert msgspec.json.decode(response.read()) == {}


@pytest.mark.parametrize("missing", ["page.pem", "page.key"])
def test_page_without_its_files_is_not_served(tmp_path: Path, missing: str) -> None:
    files = make_certificate(tmp_path)
    (tmp_path / missing).unlink()

    with pytest.raises(FileNotFoundError):
        ViewerPage("127.0.0.1", 0, PageAccess(TOKEN, *files))


def test_page_may_fetch_from_its_own_server_only(page: ViewerPage) -> None:
    with urllib.request.urlopen(url_of(page)) as response:
        policy, body = response.headers["Content-Security-Policy"], response.read()

    assert "default-src 'none'" in policy
    assert f"connect-src 'self' ws://127.0.0.1:{page.port} " in policy
    assert b"<title>zensim</title>" in body


def test_page_is_identical_when_sent_compressed(page: ViewerPage) -> None:
    request = urllib.request.Request(url_of(page), headers={"Accept-Encoding": "gzip"})

    with urllib.request.urlopen(request) as packed:
        assert packed.headers["Content-Encoding"] == "gzip"
        assert int(packed.headers["Content-Length"]) == len(packed.read())


@pytest.mark.parametrize("path", ["/", "/names"])
def test_request_is_refused_when_its_host_is_another(page: ViewerPage, path: str) -> None:
    request = urllib.request.Request(url_of(page) + path, headers={"Host": "evil.example"})

    with pytest.raises(HTTPError, match="403") as refusal:
        urllib.request.urlopen(request)

    refusal.value.close()


def test_page_is_not_served_when_its_port_is_taken(page: ViewerPage) -> None:
    with pytest.raises(PortTaken, match=f"port {page.port} on 127.0.0.1"):
        ViewerPage("127.0.0.1", page.port)


@pytest.mark.parametrize("host", ["192.0.2.1", "no.such.host.invalid"])
def test_page_is_not_served_on_a_foreign_address(host: str) -> None:
    with pytest.raises(CannotListen, match=host):
        ViewerPage(host, 0)


def test_port_is_free_again_when_the_page_is_closed() -> None:
    with closing(ViewerPage("127.0.0.1", 0)) as first:
        port = first.port

    with closing(ViewerPage("127.0.0.1", port)) as second:
        assert second.port == port


def test_links_of_robots_are_sent_when_they_move_and_their_parts_share_poses(
    page: ViewerPage, visitor: ClientConnection
) -> None:
    stripe = Shape("box", (0.1, 0.1, 0.1), rgba=(1.0, 1.0, 0.0, 1.0))
    robot = make_robot()
    base = msgspec.structs.replace(robot.links[0], visuals=(*robot.links[0].visuals, stripe))
    models = make_models_by_name(
        {"r1": msgspec.structs.replace(robot, links=(base, robot.links[1]))}
    )
    fleet = make_fleet(("r1",), models)
    page.show(fleet, make_frame(fleet, make_snapshot("r1", joints=1)), STATUS, {})
    read_updates(visitor)

    for at_x in (1.0, 1.0 + 1e-6):
        page.show(fleet, make_frame(fleet, make_snapshot("r1", joints=1, at_x=at_x)), STATUS, {})

    sent = read_updates(visitor, least=4)
    assert sorted(sent) == ["/robots/0/0/0", "/robots/0/0/1", "/robots/0/1/0", "/shadows/0/2/0"]
    assert sent["/robots/0/0/0"] == sent["/robots/0/0/1"] != sent["/robots/0/1/0"]


def read_updates(visitor: ClientConnection, least: int = 0) -> dict[str, object]:
    """Read until there are so many, and nothing comes for a moment; updates of robots by path."""
    found: dict[str, object] = {}
    with suppress(TimeoutError):
        while True:
            within_s = 0.5 if len(found) >= least else 60.0
            for message in read_messages(visitor.recv(timeout=within_s)):
                is_update = message["type"] == "SceneNodeUpdateMessage"
                if is_update and message["name"].startswith(("/robots/", "/shadows/")):
                    assert message["name"] not in found
                    found[message["name"]] = message["updates"]
    return found
