"""Keys of a replay in a terminal, as of rosbag2: space, right, up, down; and left."""

from typing import Final

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.terminal_keys import KeyParser
from zensim.recording.replay.replay_clock import MAX_RATE
from zensim.recording.replay.replayer import Replayer

RATE_STEP: Final = 1.1
LEAST_RATE: Final = 0.01
"""Keys go no further down, and not to 0, which is as fast as possible."""
BACK_S: Final = 5.0
HELP: Final = "space: pause; right: next message; up, down: rate; left: 5 s back; Ctrl-C: end"


class ReplayKeyboard:
    """Controls a replay by keys."""

    def __init__(self, replayer: Replayer, start_ns: int) -> None:
        """Control a replay whose part starts at a position [ns]."""
        self._replayer = replayer
        self._start_ns = start_ns
        self._parser = KeyParser()

    def take(self, data: bytes) -> None:
        """Take bytes of a terminal.

        Raises:
            OSError: A file cannot be read.
        """
        for event in self._parser.feed(data):
            if event.kind != "release":
                self._press(event.key)

    def describe(self) -> str:
        """Describe the state in a line."""
        replayer = self._replayer
        state = "paused" if replayer.is_paused else "playing"
        position, end = (
            one / NANOSECONDS for one in (replayer.find_position(), replayer.duration_ns)
        )
        return f"{state} {position:.2f} of {end:.2f} s, rate {replayer.rate:.3g}   {HELP}"

    def _press(self, key: str) -> None:
        replayer = self._replayer
        match key:
            case " ":
                replayer.toggle()
            case "right":
                replayer.play_next()
            case "up":
                replayer.set_rate(min(MAX_RATE, replayer.rate * RATE_STEP))
            case "down" if replayer.rate > LEAST_RATE:
                replayer.set_rate(max(LEAST_RATE, replayer.rate / RATE_STEP))
            case "left":
                back_ns = replayer.find_position() - round(BACK_S * NANOSECONDS)
                replayer.seek(max(self._start_ns, back_ns))
