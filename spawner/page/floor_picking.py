"""Points of the floor that a visitor clicks."""

from collections.abc import Callable
from math import isfinite
from typing import Final

import viser

MAX_DISTANCE_M: Final = 1e4
"""Greatest distance of the floor along the ray of a click."""
Ray = tuple[float, float, float]
Act = Callable[[], None]
PointCallback = Callable[[float, float], None]
"""Called with x and y [m] in the thread that draws."""


def do_nothing() -> None:
    """Do nothing, as where no purpose is informed."""


def find_floor_point(origin: Ray, direction: Ray, height_m: float = 0.0) -> tuple[float, float]:
    """Find where a ray meets the horizontal plane at a height.

    Raises:
        ValueError: It does not, or far away.
    """
    fall = direction[2]
    distance = (height_m - origin[2]) / fall if fall else float("inf")
    if not (isfinite(distance) and 0.0 < distance <= MAX_DISTANCE_M):
        raise ValueError("the click is not on the floor; click a point of the ground")
    return origin[0] + distance * direction[0], origin[1] + distance * direction[1]


class FloorPicker:
    """Takes the next click of a visitor on the floor, for one purpose at a time."""

    def __init__(
        self,
        scene: viser.SceneApi,
        post: Callable[[Act], None],
        warn: Callable[[str], None],
        show: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Take no click before `pick` is called.

        Args:
            scene: Of the visitor.
            post: Queues a function for the thread that draws.
            warn: Notifies the visitor.
            show: Shows the visitor that a click is awaited for a purpose; empty = not any more.
        """
        self._scene, self._post, self._warn, self._show = scene, post, warn, show
        self._wanted: tuple[str, PointCallback, Act] | None = None

    def pick(self, purpose: str, on_point: PointCallback, on_cancel: Act = do_nothing) -> None:
        """Take the next click for a purpose, in place of that for another one.

        Args:
            purpose: Word that `cancel` is called with.
            on_point: Called with the point of the floor that is clicked.
            on_cancel: Called if another purpose takes the click, it is not on the floor, or the
                visitor gives up.
        """
        before = self._wanted
        self._wanted = (purpose, on_point, on_cancel)
        if before is None:
            self._scene.on_click()(self._handle)
            self._show(purpose)
        elif before[0] != purpose:
            before[2]()

    @property
    def purpose(self) -> str:
        """Purpose that the next click serves; empty = none."""
        return self._wanted[0] if self._wanted is not None else ""

    def cancel(self, purpose: str) -> None:
        """Stop waiting for a click for this purpose."""
        if self.purpose == purpose:
            self._stop()

    def give_up(self) -> None:
        """Stop waiting for a click, and inform its purpose."""
        if self._wanted is not None:
            on_cancel = self._wanted[2]
            self._stop()
            on_cancel()

    def _stop(self) -> None:
        self._scene.remove_click_callback(self._handle)
        self._wanted = None
        self._show("")

    def _handle(self, event: viser.SceneClickEvent) -> None:
        self._post(lambda: self._take(event.ray_origin, event.ray_direction))

    def _take(self, origin: Ray, direction: Ray) -> None:
        if self._wanted is None:
            return
        _, on_point, on_cancel = self._wanted
        self._stop()
        try:
            point = find_floor_point(origin, direction)
        except ValueError as error:
            self._warn(str(error))
            on_cancel()
            return
        on_point(*point)
