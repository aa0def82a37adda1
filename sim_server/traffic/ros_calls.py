"""Requests of ROS 2: read and answered in the form in which each was asked.

Whoever asks gets a response whatever happens: rmw_zenoh takes an error for none, and waits on.
"""

import logging
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Final, TypeVar

import msgspec

from zensim.proto import bus as network
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.rmw_keys import NO_HASH
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.ros_service_catalog import (
    CDR_ENCODING_NAME,
    ROS_SERVICES,
    RosService,
    find_served_keys,
    index_by_bridge_key,
    index_by_key,
)
from zensim.sim_server.traffic.calls import Call

LOG = logging.getLogger(__name__)
Message = TypeVar("Message", bound=msgspec.Struct)
NOT_ASKED: Final = b""


class RosCall:
    """A request that came on a key of rmw_zenoh or of a bridge; see `Call`."""

    def __init__(
        self, call: network.Call, forms: tuple[RosService, ...], attachment: Attachment | None
    ) -> None:
        self._call = call
        self._forms = forms
        self._form = forms[0]
        self._attachment = attachment
        self.name = forms[0].service
        self.payload, self.size, self.encoding = call.payload, call.size, CDR_ENCODING_NAME
        self.request_id = NOT_ASKED if attachment is None else _id_of(attachment)

    def read(self, kind: type[Message]) -> Message:
        """See `Call`: the first form that fits."""
        for form in self._forms[:-1]:
            with suppress(MalformedPayload):
                return self._read(form, kind)
        return self._read(self._forms[-1], kind)

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """See `Call`: with the attachment by which ROS finds who asked."""
        del key
        answer = self._form.answer(payload, encoding)
        back = b"" if self._attachment is None else write_attachment(_of_now(self._attachment))
        self._call.reply(answer, CDR_ENCODING_NAME, attachment=back)

    def drop(self) -> None:
        """See `Call`."""
        self._call.drop()

    def _read(self, form: RosService, kind: type[Message]) -> Message:
        request = form.read(self.payload)
        self._form = form
        return _widened(request, kind)


class RosCalls:
    """All requests that come in forms of ROS 2."""

    def __init__(
        self, queues: tuple[network.CallQueue, ...], forms: Mapping[str, tuple[RosService, ...]]
    ) -> None:
        self._queues = queues
        self._forms = forms

    def take(self) -> list[Call]:
        """Take what has come; what no form fits is let go, since nobody serves it."""
        found: list[Call] = []
        for queue in self._queues:
            for call in queue.take():
                forms = self._forms.get(call.key)
                if forms is None:
                    LOG.info("no such service of ros key=%s", call.key)
                    call.drop()
                else:
                    found.append(RosCall(call, forms, read_attachment(call.request_id)))
        return found


def rmw_calls(bus: network.Bus, domain: int) -> RosCalls:
    """Serve what rmw_zenoh asks for in a domain."""
    return RosCalls(tuple(bus.serve(key) for key in find_served_keys(domain)), index_by_key(domain))


def bridge_calls(bus: network.Bus) -> RosCalls:
    """Serve what zenoh-bridge-ros2dds asks for."""
    forms = index_by_bridge_key()
    return RosCalls(tuple(bus.serve(key) for key in forms), forms)


def announce_services(node: RosNode) -> None:
    """Say that a node offers every service, in each form that its distribution has."""
    has_hashes = node.graph.settings.has_hashes
    for form in ROS_SERVICES:
        if has_hashes or form.is_humble_form:
            type_hash = form.type_hash if has_hashes else NO_HASH
            node.join(
                "SS", form.name, form.ros_type, type_hash=type_hash, bridge_key=form.bridge_key
            )


def _id_of(attachment: Attachment) -> bytes:
    return attachment.gid + attachment.sequence_number.to_bytes(8, "little", signed=True)


def _of_now(attachment: Attachment) -> Attachment:
    return msgspec.structs.replace(attachment, source_time_ns=time.time_ns())


def _widened(request: msgspec.Struct, kind: type[Message]) -> Message:
    """Give what a type of ours adds to the interface its defaults."""
    if isinstance(request, kind):
        return request
    return kind(**{name: getattr(request, name) for name in request.__struct_fields__})
