"""Statistics of the loop over windows of one second: real-time factor, step times, lateness."""

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.metric_families import DurationHistogram
from zensim.sim_server.pacing.command_counts import CommandCounts

STEP_SHARE = 4


class LoopStats:
    """Sums and maxima over windows of about one second of wall time."""

    def __init__(self, now_ns: int) -> None:
        self.real_time_factor = 0.0
        self.step_time_s = 0.0
        self.step_time_max_s = 0.0
        self.late_max_s = 0.0
        self.busy_max_s = 0.0
        self.slipped_ns = 0
        self.requests = 0
        self.refused = self.accepted = self.joined = 0
        """Counts of a secured server: see `Stats`."""
        self.steps = DurationHistogram()
        """Wall times of all steps."""
        self.lateness = DurationHistogram()
        """Delays of all steps after their deadlines."""
        self.late_steps = 0
        """Steps that began later than a step's time after their deadline."""
        self.commands = CommandCounts()
        """Commands of agents."""
        self._since_ns = now_ns
        self._simulated_ns = 0
        self._steps = 0
        self._stepping_ns = 0
        self._longest_ns = 0
        self._latest_ns = 0
        self._backlog_ns = 0
        self._busiest_ns = 0

    def note_turn(self, *, busy_ns: int, paced_ns: int) -> None:
        """Count one turn.

        Args:
            busy_ns: CPU time used.
            paced_ns: Wall time until the next deadline; 0 if no step was due.
        """
        self._backlog_ns = busy_ns + (self._backlog_ns if paced_ns else 0)
        self._busiest_ns = max(self._busiest_ns, self._backlog_ns)
        self._backlog_ns = max(0, self._backlog_ns - paced_ns) if paced_ns else 0

    def note_step(self, *, simulated_ns: int, took_ns: int, late_ns: int) -> None:
        """Count one step."""
        self._steps += 1
        self._simulated_ns += simulated_ns
        self._stepping_ns += took_ns
        self._longest_ns = max(self._longest_ns, took_ns)
        self._latest_ns = max(self._latest_ns, late_ns)
        self.steps.add(took_ns)
        self.lateness.add(late_ns)
        self.late_steps += late_ns > simulated_ns

    def work_budget_ns(self, least_ns: int) -> int:
        """Return the time [ns] that divisible work may take in a turn, at least `least_ns`.

        A quarter of the step time where that is more, so that the work ends eventually.
        """
        return max(least_ns, round(self.step_time_s * NANOSECONDS / STEP_SHARE))

    def close_window(self, now_ns: int) -> bool:
        """Compute the statistics if a second has passed; return whether it has."""
        elapsed_ns = now_ns - self._since_ns
        if elapsed_ns < NANOSECONDS:
            return False
        self.real_time_factor = self._simulated_ns / elapsed_ns
        self.step_time_s = self._stepping_ns / max(self._steps, 1) * 1e-9
        self.step_time_max_s = self._longest_ns * 1e-9
        self.late_max_s = self._latest_ns * 1e-9
        self.busy_max_s = self._busiest_ns * 1e-9
        self.commands.close_window(elapsed_ns / NANOSECONDS)
        self._since_ns = now_ns
        self._simulated_ns = self._steps = self._stepping_ns = 0
        self._longest_ns = self._latest_ns = self._busiest_ns = 0
        return True
