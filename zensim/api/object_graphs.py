"""Objects and what they refer to as MessagePack, and back; nothing but listed classes is made.

Numbers, texts and bytes stand for themselves, and a list for anything else: its first item says
what it is. An object has a number from where it begins; `again` with that number is the same one.
"""

import re
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from functools import cached_property, partial
from itertools import count
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any, ClassVar, Final, Protocol

import msgspec
import numpy as np

from zensim.api.state_classes import (
    CALLED,
    MESSAGES,
    NotState,
    find_class,
    find_function,
    find_method,
    name_of,
)

AnyArray = np.ndarray[Any, Any]
Node = list[Any]
"""What is written for an object: its kind, and what the kind needs."""
Layout = tuple[str, ...]
"""Name of a class, and of attributes."""
ArrayKind = tuple[str, tuple[int, ...], str, bool]
"""Type, shape, order (C or F), and whether it may be written."""
PLAIN: Final = frozenset({type(None), bool, float, bytes})
READ_PLAIN: Final = PLAIN | {int, str}
WORD_BITS: Final = 63
MOST_DIGITS: Final = 400
NUMBER_TYPE: Final = re.compile(r"[<|][biuf][1248]")
"""Types of arrays and their numbers: no objects, no texts."""
UNFINISHED: Final = object()
"""An object that is being read and that nothing can refer to yet."""


class Outside(Protocol):
    """Objects that are named, not written."""

    def name(self, value: object) -> Node | None:
        """Write the name of an object; None if it is to be written itself."""

    def find(self, node: Node) -> object:
        """Find the object of a name; raises KeyError or NotState."""


class GraphWriter:
    """Writes an object with all that it refers to."""

    def __init__(self, outside: Outside) -> None:
        self._outside = outside
        self._numbers: dict[int, int] = {}
        self._kept: list[object] = []
        """Written objects, kept so that the identity of each stays its own."""
        self._layouts: dict[Layout, int] = {}
        self._arrays: dict[ArrayKind, int] = {}

    def write(self, value: object) -> bytes:
        """Write an object.

        Raises:
            NotState: It refers to an object that no state has.
        """
        root = self.write_inner(value)
        return msgspec.msgpack.encode([list(self._layouts), list(self._arrays), root])

    def write_inner(self, value: object) -> object:
        """Write an object within another."""
        kind = type(value)
        if kind in PLAIN or (kind is int and value.bit_length() <= WORD_BITS):  # type: ignore[attr-defined]
            return value
        if (named := self._outside.name(value)) is not None:
            return named
        if kind is str:
            return value
        if (number := self._numbers.get(id(value))) is not None:
            return ["again", number]
        self._numbers[id(value)] = len(self._numbers)
        self._kept.append(value)
        if (write := _WRITERS.get(kind)) is None:
            write = _WRITERS[kind] = _choose_writer(kind)
        return write(self, value)

    def write_all(self, name: str, values: Iterable[object]) -> Node:
        """Write a container."""
        return [name, *map(self.write_inner, values)]

    def write_mapping(self, name: str, mapping: Mapping[Any, Any]) -> Node:
        """Write keys and values, one after another."""
        return [name, *(self.write_inner(one) for pair in mapping.items() for one in pair)]

    def write_object(self, value: object) -> Node:
        """Write the attributes of an object, as its `__getstate__` selects them."""
        kind = type(value)
        if (select := _find_own(kind, "__getstate__")) is not None:
            state = {name: one for name, one in select(value).items() if name[:2] != "__"}
        else:
            state = list_attributes(value)
        return ["object", self.layout(kind, state), *map(self.write_inner, state.values())]

    def write_fields(self, name: str, value: object, fields: Iterable[str]) -> Node:
        """Write the fields of a struct or named tuple."""
        values = [self.write_inner(getattr(value, one)) for one in fields]
        return [name, self.layout(type(value)), *values]

    def write_reduced(self, value: object) -> Node:
        """Write the function that finds an object, and its arguments."""
        reduced: Any = value.__reduce__()
        function, arguments = reduced
        name = name_of(function)
        find_function(name, CALLED)
        return ["found", name, *map(self.write_inner, arguments)]

    def write_array(self, array: AnyArray) -> Node:
        """Write the numbers of an array, or how it is a view of another."""
        base, dtype = array.base, _write_number_type(array.dtype)
        if is_view(array):
            assert isinstance(base, np.ndarray)
            start = array.__array_interface__["data"][0] - base.__array_interface__["data"][0]
            return ["view", self.write_inner(base), dtype, start, array.shape, array.strides]
        order: Any = "F" if array.flags.fnc else "C"
        kind = dtype, array.shape, order, array.flags.writeable
        number = self._arrays.setdefault(kind, len(self._arrays))
        return ["array", number, array.tobytes(order)]

    def layout(self, kind: type, names: Iterable[str] = ()) -> int:
        """Number a class with the names of attributes.

        Raises:
            NotState: No state has objects of this class.
        """
        layout = name_of(kind), *names
        if (number := self._layouts.get(layout)) is None:
            if find_class(layout[0]) is not kind:
                raise NotState(f"class {layout[0]!r}")
            number = self._layouts[layout] = len(self._layouts)
        return number


class GraphReader:
    """Reads what `GraphWriter` wrote."""

    def __init__(self, outside: Outside) -> None:
        self._outside = outside
        self._objects: list[object] = []
        self._layouts: list[tuple[type, tuple[str, ...]]] = []
        self._arrays: list[ArrayKind] = []

    def read(self, data: bytes) -> object:
        """Read an object.

        Raises:
            NotState: The bytes name what no state has.
            Exception: Of other bytes; nothing but memory was changed.
        """
        layouts, arrays, root = msgspec.msgpack.decode(data)
        self._layouts = [(find_class(kind), tuple(names)) for kind, *names in layouts]
        self._arrays = [_read_array_kind(kind) for kind in arrays]
        return self._read(root)

    def _read(self, node: Any) -> Any:  # noqa: ANN401  of any kind
        kind = type(node)
        if kind in READ_PLAIN:
            return node
        if kind is not list:
            raise NotState(f"a value of {kind.__name__}")
        if (read := self._readers.get(node[0])) is not None:
            return read(self, node)
        if (make := _MAKERS.get(node[0])) is not None:
            return self._made(node, make)
        return self._outside.find(node)

    def _begin(self, value: object = UNFINISHED) -> int:
        """Number an object that is read next."""
        self._objects.append(value)
        return len(self._objects) - 1

    def _again(self, node: Node) -> object:
        value = self._objects[node[1]]
        if value is UNFINISHED:
            raise NotState("a value that refers to itself")
        return value

    def _values(self, node: Node, start: int = 1) -> list[Any]:
        read, plain = self._read, READ_PLAIN
        return [one if type(one) in plain else read(one) for one in node[start:]]

    def _made(self, node: Node, make: Callable[[list[Any]], object], start: int = 1) -> object:
        """Make what cannot refer to itself."""
        number = self._begin()
        value = self._objects[number] = make(self._values(node, start))
        return value

    def _list(self, node: Node) -> list[object]:
        found: list[object] = []
        self._begin(found)
        found += self._values(node)
        return found

    def _set(self, node: Node) -> set[object]:
        found: set[object] = set()
        self._begin(found)
        found.update(self._values(node))
        return found

    def _deque(self, node: Node) -> deque[object]:
        found: deque[object] = deque(maxlen=node[1])
        self._begin(found)
        found.extend(self._values(node, 2))
        return found

    def _mapping(self, node: Node) -> dict[object, object]:
        found: dict[object, object] = _MAPPINGS[node[0]]()
        self._begin(found)
        values = iter(node[1:])
        for key in values:
            known = self._read(key)
            found[known] = self._read(next(values))
        return found

    def _object(self, node: Node) -> object:
        kind, names = self._layouts[node[1]]
        found: Any = object.__new__(kind)
        self._begin(found)
        state = dict(zip(names, self._values(node, 2), strict=True))
        _check_attributes(kind, names)
        if (take := _find_own(kind, "__setstate__")) is not None:
            take(found, state)
            return found
        for name in _slots(kind):
            if name in state:
                object.__setattr__(found, name, state.pop(name))
        if state:
            found.__dict__.update(state)
        return found

    def _struct(self, node: Node) -> object:
        kind, _ = self._layouts[node[1]]
        fields = kind.__struct_fields__  # type: ignore[attr-defined]
        return self._made(node, lambda values: kind(**dict(zip(fields, values, strict=True))), 2)

    def _named_tuple(self, node: Node) -> object:
        kind, _ = self._layouts[node[1]]
        return self._made(node, kind._make, 2)  # type: ignore[attr-defined]

    def _message(self, node: Node) -> object:
        kind, _ = self._layouts[node[1]]
        if not kind.__module__.startswith(MESSAGES):
            raise NotState(f"message {kind.__name__}")
        value: object = msgspec.msgpack.decode(node[2], type=kind)
        self._begin(value)
        return value

    def _enum(self, node: Node) -> object:
        kind, _ = self._layouts[node[1]]
        if not issubclass(kind, Enum):
            raise NotState(f"enumeration {kind.__name__}")
        value = kind(node[2])
        self._begin(value)
        return value

    def _class(self, node: Node) -> object:
        kind, _ = self._layouts[node[1]]
        self._begin(kind)
        return kind

    def _function(self, node: Node) -> object:
        found = find_function(node[1])
        self._begin(found)
        return found

    def _method(self, node: Node) -> object:
        number = self._begin()
        found = self._objects[number] = find_method(self._read(node[2]), node[1])
        return found

    def _found(self, node: Node) -> object:
        function = find_function(node[1], CALLED)
        return self._made(node, lambda values: function(*values), 2)

    def _array(self, node: Node) -> AnyArray:
        dtype, shape, order, is_writable = self._arrays[node[1]]
        numbers = bytearray(_check_bytes(node[2]))
        array: AnyArray = np.ndarray(shape, dtype, numbers, order=order)  # type: ignore[arg-type]
        array.flags.writeable = is_writable
        self._begin(array)
        return array

    def _view(self, node: Node) -> AnyArray:
        number = self._begin()
        _, base_node, dtype, start, shape, strides = node
        base = self._read(base_node)
        buffer = base if base.flags.c_contiguous else base.T
        found: AnyArray = np.ndarray(shape, _read_number_type(dtype), buffer, start, strides)
        self._objects[number] = found
        return found

    _readers: ClassVar[dict[str, Callable[["GraphReader", Node], object]]] = {
        "again": _again,
        "list": _list,
        "set": _set,
        "dict": _mapping,
        "ordered": _mapping,
        "counter": _mapping,
        "deque": _deque,
        "method": _method,
        "function": _function,
        "array": _array,
        "view": _view,
        "enum": _enum,
        "class": _class,
        "message": _message,
        "struct": _struct,
        "named_tuple": _named_tuple,
        "found": _found,
        "object": _object,
    }


def list_attributes(value: object) -> dict[str, object]:
    """List the attributes that an object of the state has of its own; of others, nothing."""
    kind = type(value)
    if (found := _ATTRIBUTES.get(kind)) is None:
        found = _ATTRIBUTES[kind] = _find_attributes(kind)
    slots, left_out = found
    attributes = {name: getattr(value, name) for name in slots if hasattr(value, name)}
    if left_out is not None:
        more = value.__dict__.items()
        attributes.update([pair for pair in more if pair[0] not in left_out])
    return attributes


def _find_attributes(kind: type) -> tuple[tuple[str, ...], frozenset[str] | None]:
    """Find the slots of a class, and what to leave out of its dictionary; None if it has none."""
    if not kind.__module__.startswith("zensim.") or issubclass(kind, Enum):
        return (), None
    fields = getattr(kind, "__struct_fields__", None) or getattr(kind, "_fields", None)
    if fields is not None or kind.__dictoffset__ == 0:
        return fields or _slots(kind), None
    inherited = [item for base in kind.__mro__ for item in vars(base).items()]
    cached = {name for name, one in inherited if isinstance(one, cached_property)}
    return _slots(kind), frozenset(cached | {"__orig_class__"})


def is_view(array: AnyArray) -> bool:
    """Whether an array is a view of another, so that a change of one is a change of both."""
    base = array.base
    return isinstance(base, np.ndarray) and bool(base.flags.writeable) and array.size > 0


def _write_number_type(dtype: "np.dtype[Any]") -> str:
    if not NUMBER_TYPE.fullmatch(dtype.str):
        raise NotState(f"numbers of type {dtype}")
    return str(dtype.str)


def _read_number_type(text: str) -> "np.dtype[Any]":
    if not NUMBER_TYPE.fullmatch(text):
        raise NotState(f"numbers of type {text[:20]!r}")
    return np.dtype(text)


def _read_array_kind(saved: Node) -> ArrayKind:
    dtype, shape, order, is_writable = saved
    return _read_number_type(dtype).str, tuple(shape), order, bool(is_writable)


def _check_bytes(value: object) -> bytes:
    if not isinstance(value, bytes):  # a number would be that many bytes
        raise NotState(f"a value of {type(value).__name__} in place of bytes")
    return value


def _slots(kind: type) -> tuple[str, ...]:
    """List the slots of a class."""
    if (found := _SLOTS.get(kind)) is None:
        names = [vars(base).get("__slots__", ()) for base in kind.__mro__]
        listed = [(one,) if isinstance(one, str) else tuple(one) for one in names]
        found = tuple(name for one in listed for name in one if not name.startswith("__"))
        _SLOTS[kind] = found
    return found


def _find_own(kind: type, name: str) -> Callable[..., Any] | None:
    """Find a method that a class defines itself, not the one of all data classes with slots."""
    if (kind, name) not in _OWN:
        found = getattr(kind, name, None)
        is_own = isinstance(found, FunctionType) and found.__module__ != "dataclasses"
        _OWN[kind, name] = found if is_own else None
    return _OWN[kind, name]


def _check_attributes(kind: type, names: tuple[str, ...]) -> None:
    """Check that no attribute hides a method or property, or is missing; once a layout."""
    if (kind, names) in _CHECKED:
        return
    fields = set(getattr(kind, "__dataclass_fields__", ()))
    hidden = [
        name
        for name in names
        if name.startswith("__") or isinstance(getattr(kind, name, None), FunctionType | property)
    ]
    if hidden or fields - set(names):
        raise NotState(f"attributes of {kind.__name__}: {', '.join(names)[:200]}")
    _CHECKED.add((kind, names))


def _choose_writer(kind: type) -> "Writer":
    """Choose how objects of a class are written."""
    for base, write in _BASE_WRITERS:
        if issubclass(kind, base):
            return write
    if hasattr(kind, "_fields") and issubclass(kind, tuple):
        fields: tuple[str, ...] = vars(kind)["_fields"]
        return lambda graph, value: graph.write_fields("named_tuple", value, fields)
    if _find_own(kind, "__reduce__") is not None:
        return GraphWriter.write_reduced
    return GraphWriter.write_object


def _write_struct(graph: GraphWriter, value: Any) -> Node:  # noqa: ANN401  of any struct
    kind = type(value)
    if _find_own(kind, "__reduce__") is not None:
        return graph.write_reduced(value)
    if kind.__module__.startswith(MESSAGES):
        return ["message", graph.layout(kind), msgspec.msgpack.encode(value)]
    return graph.write_fields("struct", value, kind.__struct_fields__)


def _write_function(_: GraphWriter, value: Callable[..., object]) -> Node:
    name = name_of(value)
    find_function(name)
    return ["function", name]


def _write_method(graph: GraphWriter, value: MethodType) -> Node:
    find_method(value.__self__, value.__name__)
    return ["method", value.__name__, graph.write_inner(value.__self__)]


def _write_partial(graph: GraphWriter, value: "partial[Any]") -> Node:
    return graph.write_all("partial", (value.func, value.args, value.keywords))


def _write_count(_: GraphWriter, value: object) -> Node:
    return ["count", int(repr(value).partition("(")[2].rstrip(")"))]


Writer = Callable[[GraphWriter, Any], Node]
_SLOTS: dict[type, tuple[str, ...]] = {}
_ATTRIBUTES: dict[type, tuple[tuple[str, ...], frozenset[str] | None]] = {}
_OWN: dict[tuple[type, str], Callable[..., Any] | None] = {}
_CHECKED: set[tuple[type, tuple[str, ...]]] = set()
_MAPPINGS: Final[dict[str, type]] = {"dict": dict, "ordered": OrderedDict, "counter": Counter}
_WRITERS: dict[type, Writer] = {
    int: lambda _, value: ["integer", str(value)],
    bytearray: lambda _, value: ["bytearray", bytes(value)],
    list: lambda graph, value: graph.write_all("list", value),
    tuple: lambda graph, value: graph.write_all("tuple", value),
    set: lambda graph, value: graph.write_all("set", value),
    frozenset: lambda graph, value: graph.write_all("frozenset", value),
    dict: lambda graph, value: graph.write_mapping("dict", value),
    OrderedDict: lambda graph, value: graph.write_mapping("ordered", value),
    Counter: lambda graph, value: graph.write_mapping("counter", value),
    deque: lambda graph, value: ["deque", value.maxlen, *graph.write_all("", value)[1:]],
    slice: lambda graph, value: graph.write_all("slice", (value.start, value.stop, value.step)),
    count: _write_count,
    partial: _write_partial,
    MethodType: _write_method,
    FunctionType: _write_function,
    BuiltinFunctionType: _write_function,
    np.ndarray: GraphWriter.write_array,
}
_BASE_WRITERS: Final[tuple[tuple[type, Writer], ...]] = (
    (Enum, lambda graph, value: ["enum", graph.layout(type(value)), value.value]),
    (type, lambda graph, value: ["class", graph.layout(value)]),
    (msgspec.Struct, _write_struct),
    (np.dtype, lambda _, value: ["number_type", _write_number_type(value)]),
    (np.generic, lambda _, value: ["number", _write_number_type(value.dtype), value.tobytes()]),
)
_MAKERS: Final[dict[str, Callable[[list[Any]], object]]] = {
    "integer": lambda values: int(str(values[0])[:MOST_DIGITS]),
    "bytearray": lambda values: bytearray(_check_bytes(values[0])),
    "tuple": tuple,
    "frozenset": frozenset,
    "slice": lambda values: slice(*values),
    "count": lambda values: count(values[0]),
    "partial": lambda values: partial(values[0], *values[1], **values[2]),
    "number_type": lambda values: _read_number_type(values[0]),
    "number": lambda values: np.frombuffer(values[1], _read_number_type(values[0]))[0],
}
"""Objects that are made of what follows their kind."""
