"""What an agent does now and then besides driving; in wall time."""

import logging

from robot_agent.fleet import Fleet

LOG = logging.getLogger("zensim.agent")
ANNOUNCE_S = 0.2
COMPLAIN_S = 1.0


class Upkeep:
    """Answers questions, greets new listeners, and says what was malformed."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._announce_s = self._complain_s = 0.0

    def poll(self, now_s: float) -> None:
        """Answer, and do what else is due."""
        for robot in self._fleet.robots:
            robot.answer()
        if now_s >= self._announce_s:
            self._announce_s = now_s + ANNOUNCE_S
            self._announce()
        if now_s >= self._complain_s:
            self._complain_s = now_s + COMPLAIN_S
            self._complain()

    def _announce(self) -> None:
        for robot in self._fleet.robots:
            robot.announce()

    def _complain(self) -> None:
        for robot in self._fleet.robots:
            if robot.commanded and (complaint := robot.commanded.take_complaint()):
                LOG.warning("cmd_vel entity=%s %s", robot.entity, complaint)
