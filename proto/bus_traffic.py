"""Messages and bytes that a session has sent and received."""

from collections.abc import Iterator

from zensim.proto.metric_families import MetricFamily, make_labelled


class BusTraffic:
    """Counts of a session and of those opened from it, since the start.

    Threads of one session may lose a count.
    """

    def __init__(self) -> None:
        self.sent = self.sent_bytes = 0
        """Messages and bytes that were published, and replies."""
        self.received = self.received_bytes = 0
        """Messages taken from subscriptions, and requests whose bytes were read."""

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List the counts by direction."""
        yield make_labelled(
            "zensim_bus_messages_total",
            "counter",
            "Messages published and received, requests received and answered.",
            {("sent",): self.sent, ("received",): self.received},
            "direction",
        )
        yield make_labelled(
            "zensim_bus_bytes_total",
            "counter",
            "Their payloads.",
            {("sent",): self.sent_bytes, ("received",): self.received_bytes},
            "direction",
        )
