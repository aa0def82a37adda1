"""Messages that the page accepts from browsers: known types, finite numbers, offered values."""

from collections.abc import Sequence
from itertools import chain
from math import isfinite
from typing import Annotated, Final, Literal, TypeAlias
from weakref import WeakValueDictionary

import msgspec
from viser._messages import (
    GuiBaseProps,
    GuiButtonGroupProps,
    GuiButtonProps,
    GuiCheckboxProps,
    GuiDropdownProps,
    GuiNumberProps,
    GuiSliderProps,
    GuiTextProps,
    GuiVector2Props,
    GuiVector3Props,
)
from viser.infra import Message

Name: TypeAlias = Annotated[str, msgspec.Meta(max_length=256)]
Text: TypeAlias = Annotated[str, msgspec.Meta(max_length=1000)]
Vector: TypeAlias = tuple[float, float, float]
Pixels: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=1 << 16)]
NewValueType: TypeAlias = (
    bool | float | Text | Annotated[tuple[float, ...], msgspec.Meta(max_length=4)]
)
_CONTROLS: Final[WeakValueDictionary[str, GuiBaseProps]] = WeakValueDictionary()
"""Properties of all controls that are there, by uuid."""


class ViewerCameraMessage(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """The camera of a page has moved."""

    wxyz: tuple[float, float, float, float]
    position: Vector
    fov: float
    near: float
    far: float
    image_height: Pixels
    image_width: Pixels
    look_at: Vector
    up_direction: Vector


class NewValue(msgspec.Struct, forbid_unknown_fields=True):
    """The only attribute of a control that a page may set."""

    value: NewValueType


class GuiUpdateMessage(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """A control was used."""

    uuid: Name
    updates: NewValue


class SceneNodeClickMessage(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """A robot was clicked."""

    name: Name
    instance_index: Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)] | None
    ray_origin: Vector
    ray_direction: Vector
    screen_pos: tuple[float, float]
    modifier: Name | None
    owner: Name = ""


class ScenePointerMessage(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """A place in the scene was clicked; sent only while the page waits for one."""

    event_type: Literal["click"]
    ray_origin: Vector
    ray_direction: Vector
    screen_pos: Annotated[tuple[tuple[float, float], ...], msgspec.Meta(max_length=1)]
    modifier: Name | None


class GuiButtonHoldMessage(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """A button is held; sent at a rate until it is released."""

    uuid: Name
    frequency: float


class CommandTriggerMessage(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    """A command of the palette was chosen, or its key was pressed."""

    uuid: Name


class TransformControlsUpdateMessage(
    msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True
):
    """Handles in the scene were dragged to a pose."""

    name: Name
    wxyz: tuple[float, float, float, float]
    position: Vector
    owner: Name = ""


class TransformControlsDragStartMessage(
    msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True
):
    """Handles in the scene were grabbed."""

    name: Name
    owner: Name = ""


class TransformControlsDragEndMessage(
    msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True
):
    """Handles in the scene were released."""

    name: Name
    owner: Name = ""


PageMessage: TypeAlias = (
    ViewerCameraMessage
    | GuiUpdateMessage
    | SceneNodeClickMessage
    | ScenePointerMessage
    | GuiButtonHoldMessage
    | CommandTriggerMessage
    | TransformControlsUpdateMessage
    | TransformControlsDragStartMessage
    | TransformControlsDragEndMessage
)
_PAGE_MESSAGES: Final = msgspec.msgpack.Decoder(PageMessage)


def read_page_message(raw: str | bytes) -> PageMessage | None:
    """Read a message that a page of this server sends; None if it is none, or not finite.

    viser sets whatever attribute of a control a message names, and keeps uploads; it gets neither.
    """
    if isinstance(raw, str):
        return None
    try:
        message = _PAGE_MESSAGES.decode(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        return None
    return message if all(isfinite(number) for number in _list_numbers(message)) else None


def _list_numbers(message: PageMessage) -> tuple[float, ...]:
    if isinstance(message, ViewerCameraMessage):
        return (
            *(message.fov, message.near, message.far),
            *(*message.wxyz, *message.position, *message.look_at, *message.up_direction),
        )
    if isinstance(message, SceneNodeClickMessage):
        return (*message.ray_origin, *message.ray_direction, *message.screen_pos)
    if isinstance(message, ScenePointerMessage):
        return (*message.ray_origin, *message.ray_direction, *chain(*message.screen_pos))
    if isinstance(message, TransformControlsUpdateMessage):
        return (*message.wxyz, *message.position)
    if isinstance(message, GuiButtonHoldMessage):
        return (message.frequency,)
    return _list_values(message.updates.value) if isinstance(message, GuiUpdateMessage) else ()


def _list_values(value: NewValueType) -> tuple[float, ...]:
    if isinstance(value, str):
        return ()
    return value if isinstance(value, tuple) else (value,)


def note_control(message: Message) -> None:
    """Note the properties of a control that this message adds; viser changes them in place."""
    props = getattr(message, "props", None)
    if isinstance(props, GuiBaseProps):
        _CONTROLS[message.uuid] = props  # type: ignore[attr-defined]


def is_offered(message: PageMessage) -> bool:
    """Whether a page may send this message now: a control takes only values that it offers."""
    if not isinstance(message, GuiUpdateMessage | GuiButtonHoldMessage):
        return True
    props = _CONTROLS.get(message.uuid)
    if props is None or props.disabled:
        return False
    if isinstance(message, GuiButtonHoldMessage):
        frequencies = props._hold_callback_freqs if isinstance(props, GuiButtonProps) else ()  # noqa: SLF001
        return message.frequency in frequencies
    return is_value_of(props, message.updates.value)


def is_value_of(props: GuiBaseProps, value: NewValueType) -> bool:
    """Whether a control with these properties offers a value."""
    if isinstance(props, GuiButtonProps | GuiCheckboxProps):
        return isinstance(value, bool)
    if isinstance(props, GuiDropdownProps | GuiButtonGroupProps):
        return value in props.options
    if isinstance(props, GuiTextProps):
        return isinstance(value, str)
    return not isinstance(value, bool | str) and _is_number_of(props, value)


def _is_number_of(props: GuiBaseProps, value: float | tuple[float, ...]) -> bool:
    if isinstance(props, GuiNumberProps | GuiSliderProps):
        return not isinstance(value, tuple) and _is_between((value,), (props.min,), (props.max,))
    if not isinstance(props, GuiVector2Props | GuiVector3Props) or not isinstance(value, tuple):
        return False
    size = 2 if isinstance(props, GuiVector2Props) else 3
    none: tuple[float | None, ...] = (None,) * size
    return len(value) == size and _is_between(value, props.min or none, props.max or none)


def _is_between(
    value: tuple[float, ...], least: Sequence[float | None], most: Sequence[float | None]
) -> bool:
    return all(
        (low is None or number >= low) and (high is None or number <= high)
        for number, low, high in zip(value, least, most, strict=True)
    )
