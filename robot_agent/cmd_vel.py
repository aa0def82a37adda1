"""What a robot is told to do: the newest cmd_vel, until it is too old."""

from zensim.proto.bus import Sample
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.standard_messages import Twist
from zensim.robot_agent.network import Subscription

DEPTH = 8
"""A bad message does not hide the good one before it."""
STILL = Twist()


class CommandedTwist:
    """The twist that holds now; a standing robot until a first one has come."""

    def __init__(self, subscription: Subscription, timeout_ns: int) -> None:
        """Take the channel.

        Args:
            subscription: To cmd_vel.
            timeout_ns: Simulation time that a twist holds after it was first seen; 0 = for ever.
        """
        self.malformed = 0
        """Messages that were no velocity command, since the start."""
        self._complained = 0
        self._fault = ""
        self._subscription = subscription
        self._timeout_ns = timeout_ns
        self.twist = STILL
        """As it was when it was asked for last."""
        self._seen_ns = 0

    def reset(self) -> None:
        """Forget the twist; one that waits in the channel still counts."""
        self.twist = STILL

    def at(self, time_ns: int) -> Twist:
        """Find the twist at a moment of simulation time."""
        for sample in reversed(self._subscription.take()):
            twist = self._read(sample)
            if twist is not None:
                self.twist, self._seen_ns = twist, time_ns
                break
        if self._timeout_ns and time_ns - self._seen_ns > self._timeout_ns:
            self.twist = STILL
        return self.twist

    def take_complaint(self) -> str:
        """Say what was malformed since the last time; empty when nothing was."""
        if self.malformed == self._complained:
            return ""
        self._complained = self.malformed
        return f"malformed={self.malformed} reason={self._fault!r}"

    def close(self) -> None:
        """Stop listening."""
        self._subscription.close()

    def _read(self, sample: Sample) -> Twist | None:
        try:
            return decode_twist(sample.payload, sample.encoding)
        except MalformedPayload as error:
            self.malformed += 1
            self._fault = str(error)
            return None
