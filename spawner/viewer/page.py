"""The page: what all visitors share, and what each of them did. viser's handles live here."""

import time
from collections.abc import Mapping
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Final, cast

import msgspec
import numpy as np
import viser

from zensim.proto.messages.world_messages import Scene
from zensim.spawner.viewer import stage
from zensim.spawner.viewer.buttons import BUTTONS, Button
from zensim.spawner.viewer.drawn import LABEL_GAP_M, MAX_LABELS, DrawnFleet
from zensim.spawner.viewer.lighting import Lighting
from zensim.spawner.viewer.panel import status_html
from zensim.spawner.viewer.scene import Fleet, Frame, LastCommand, Status
from zensim.spawner.viewer.serving import close_server, open_server
from zensim.spawner.viewer.visitor import Visitor

TEXT_PERIOD_S: Final = 0.15
"""The panel's text and the names need not keep up with the picture."""


class Opened(msgspec.Struct, frozen=True):
    """Somebody opened the page."""

    visitor: int


class Closed(msgspec.Struct, frozen=True):
    """Somebody closed the page."""

    visitor: int


class Picked(msgspec.Struct, frozen=True):
    """Somebody clicked a robot; no entity means that they follow nobody."""

    visitor: int
    entity: str


class Pressed(msgspec.Struct, frozen=True):
    """Somebody pressed a button."""

    button: Button


class Searched(msgspec.Struct, frozen=True):
    """Somebody wants to see everybody."""

    visitor: int


Visit = Opened | Closed | Picked | Searched


class Page:
    """A page on a port. viser's threads only leave deeds; one thread, the caller's, does the rest.

    Raises:
        PortTaken: Another program listens there.
        CannotListen: This machine does not let us.
    """

    def __init__(self, host: str, port: int) -> None:
        self._deeds: SimpleQueue[Visit | Pressed] = SimpleQueue()
        self._visitors: dict[int, Visitor] = {}
        self._fleet, self._frame = Fleet(), Frame()
        self._names = b"{}"
        self._texts_due = 0.0
        self._server = open_server(host, port, lambda: self._names)
        stage.build(self._server)
        self._lighting = Lighting(self._server.scene)
        self._lighting.show(Scene())
        self._drawn = DrawnFleet(self._server.scene, self._pick)
        self._status = self._server.gui.add_html(status_html(Status()))
        self._buttons = self._server.gui.add_button_group("Simulation", BUTTONS)
        self._buttons.on_click(lambda e: self._deeds.put(Pressed(cast("Button", e.target.value))))
        self._has_names = self._server.gui.add_checkbox(
            "Names", initial_value=False, hint=f"Above robots, the first {MAX_LABELS} of them."
        )
        everybody = self._server.gui.add_button("Show all", color=stage.QUIET)
        everybody.on_click(self._search)
        self._server.on_client_connect(lambda client: self._deeds.put(Opened(client.client_id)))
        self._server.on_client_disconnect(lambda client: self._deeds.put(Closed(client.client_id)))

    @property
    def port(self) -> int:
        """Where the page is."""
        return self._server.get_port()

    @property
    def is_watched(self) -> bool:
        """Whether anybody has the page open."""
        return bool(self._visitors)

    @property
    def followed(self) -> frozenset[str]:
        """The entities that somebody follows."""
        return frozenset(v.follows for v in self._visitors.values() if v.follows)

    def attend(self, timeout_s: float) -> list[Button]:
        """Wait so long for visitors to do something; return the buttons that they pressed."""
        pressed = []
        with suppress(Empty):
            deed = self._deeds.get(timeout=timeout_s)
            while True:
                if isinstance(deed, Pressed):
                    pressed.append(deed.button)
                else:
                    self._heed(deed)
                deed = self._deeds.get_nowait()
        return pressed

    def show(
        self, fleet: Fleet, frame: Frame, status: Status, commands: Mapping[str, LastCommand]
    ) -> None:
        """Draw one snapshot."""
        self._fleet, self._frame = fleet, frame
        with self._server.atomic():
            self._lighting.show(fleet.scene)
            self._drawn.show(fleet, frame)
        self._names = self._drawn.names_json()
        for visitor in self._present():
            visitor.keep_in_view(fleet.names, frame.base[:, :3])
        self.glide()
        if time.monotonic() >= self._texts_due:
            self._texts_due = time.monotonic() + TEXT_PERIOD_S
            self._write(status, commands)

    def glide(self) -> None:
        """Bring every camera nearer to the robot that it follows; call it often."""
        has_label = not self._has_names.value
        for visitor in self._present():
            if visitor.follows in self._fleet.rows:
                position = self._frame.base[self._fleet.rows[visitor.follows], :3]
                top_m = self._drawn.top_m(self._fleet.forms[visitor.follows]) + LABEL_GAP_M
                label_at = position + np.array((0.0, 0.0, top_m))
                visitor.move(position, label_at=label_at, has_label=has_label)

    def lose(self) -> None:
        """Show that no server answers."""
        self._status.content = status_html(Status())

    def warn(self, text: str) -> None:
        """Tell every visitor once."""
        for visitor in self._present():
            visitor.warn(text)

    def close(self) -> None:
        """Stop serving."""
        close_server(self._server)

    def _present(self) -> list[Visitor]:
        """Visitors that viser still knows: a page may have gone without its deed being read."""
        connected = self._server.get_clients()
        return [visitor for number, visitor in self._visitors.items() if number in connected]

    def _pick(self, visitor: int, entity: str) -> None:
        self._deeds.put(Picked(visitor, entity))

    def _search(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client_id is not None:
            self._deeds.put(Searched(event.client_id))

    def _heed(self, deed: Visit) -> None:
        number = deed.visitor
        client = self._server.get_clients().get(number)
        if isinstance(deed, Closed) or client is None:
            self._visitors.pop(number, None)
        elif isinstance(deed, Opened):
            self._visitors[number] = Visitor(client, lambda: self._pick(number, ""))
        elif isinstance(deed, Picked):
            self._visitors[number].follow(self._fleet.members.get(deed.entity))
        else:
            self._visitors[number].follow(None)
            if self._fleet.names:
                self._visitors[number].look_at_all(self._fleet.names, self._frame.base[:, :3])

    def _write(self, status: Status, commands: Mapping[str, LastCommand]) -> None:
        self._status.content = status_html(status)
        self._drawn.label(self._fleet, self._frame, is_on=self._has_names.value)
        for visitor in self._present():
            if visitor.follows in self._fleet.rows:
                state = self._frame.base[self._fleet.rows[visitor.follows]]
                member = self._fleet.members[visitor.follows]
                visitor.tell(member, state, commands.get(visitor.follows))
            else:
                visitor.follow(None)
