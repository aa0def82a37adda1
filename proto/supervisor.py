"""Supervisor of local processes: starts, restarts and ends programs."""

import math
import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from zensim.proto.child_process import (
    CAN_COPY,
    Process,
    close_pipes,
    end_processes,
    make_module_command,
    start_process,
)
from zensim.proto.parent_death import PARENT_PID_VARIABLE, set_subreaper
from zensim.proto.process_copies import AdoptedProcess
from zensim.proto.setting_variables import CONFIG_VARIABLE, name_variable
from zensim.proto.verbosity import CURRENT, LOG_FORMAT_VARIABLE

TERMINATE_TIMEOUT_S = 1.2
"""Grace period before SIGKILL; all processes but recorders must end within 2 s."""
RECORDER_GRACE_S = 30.0
"""Grace period of a recorder, which may have 100 MiB to write to a slow disk."""
RESTART_DELAY_S = 0.5
STEADY_S = 5.0
"""A program that has run for so long is restarted at once."""
MAX_RESTARTS = 20
CLI_MODULE, PREPARED_START_MODULE = "zensim", "zensim.api.prepared_start"
"""Modules to run: with command-line arguments, or with JSON settings."""
COPIES_SUFFIX = "s"
"""End of the verb of `PREPARED_START_MODULE` that makes a copy for each of its settings."""
MAX_COPIES = 64
"""Copies of one process: their settings are one argument, of 128 KiB at most."""
COPIES_TIMEOUT_S = 10.0


SHARED_VARIABLES = "ZENSIM_CONNECT", "ZENSIM_ENGINE", "ZENSIM_JOURNAL", "ZENSIM_WORLD"
"""Settings of several commands."""


class ProgramDied(Exception):
    """A process exited that is not restarted."""


def hide_settings(environment: Mapping[str, str], verb: str) -> dict[str, str]:
    """Empty the variables that would be settings of a program that gets all as arguments.

    Args:
        environment: All variables.
        verb: First argument of the program; empty for a module that has none.
    """
    hidden = (CONFIG_VARIABLE, *([name_variable(verb, "")] if verb else ()))
    return {name: "" for name in environment if name.startswith(hidden) or name in SHARED_VARIABLES}


@dataclass
class SupervisedProgram:
    """One process, and how to restart it."""

    name: str
    arguments: tuple[str, ...]
    is_restarted: bool = False
    is_essential: bool = True
    """Whether the others cannot do without it."""
    module: str = CLI_MODULE
    process: Process | None = None
    is_restarted_if_killed: bool = False
    """Whether it is restarted, though not `is_restarted`, if a signal has ended it."""
    restarts: int = 0
    failures: int = 0
    """Ends with another status than 0."""
    grace_s: float = TERMINATE_TIMEOUT_S
    """Time from SIGTERM to SIGKILL."""
    started_s: float = 0.0
    """Monotonic time of the last start."""
    restart_at_s: float = 0.0
    """Monotonic time of the next start; infinite = it is not started again."""


@dataclass(frozen=True)
class PendingCopies:
    """A process that makes copies of itself, one for each of these programs."""

    original: "subprocess.Popen[bytes]"
    programs: Sequence[SupervisedProgram]

    def take(self) -> None:
        """Give each program its process; if that failed, let each start alone."""
        assert self.original.stdout is not None
        pids = self.original.stdout.read().split()
        close_pipes(self.original)
        is_done = self.original.returncode == 0 and len(pids) == len(self.programs)
        for program, pid in zip(self.programs, pids, strict=False) if is_done else ():
            program.process = AdoptedProcess(int(pid))
        for program in self.programs:
            program.restart_at_s = 0.0


@dataclass
class Supervisor:
    """Owner of processes; `close` ends all."""

    on_restart: Callable[[SupervisedProgram, int], None]
    errors: int | None = None
    """File descriptor of the programs' standard error; None = that of this process."""
    programs: list[SupervisedProgram] = field(default_factory=list)
    _pending: list[PendingCopies] = field(default_factory=list)

    def start_alike(self, verb: str, settings: Mapping[str, str]) -> None:
        """Start a program for each of these JSON settings, by name; they are restarted.

        Where a process can be copied, they share what they import: see `process_copies`.
        """
        programs = [
            SupervisedProgram(name, (verb, text), is_restarted=True, module=PREPARED_START_MODULE)
            for name, text in settings.items()
        ]
        self.programs += programs
        if not CAN_COPY or len(programs) <= 1:
            for program in programs:
                program.process = self._start_process(program)
            return
        set_subreaper(is_one=True)
        for first in range(0, len(programs), MAX_COPIES):
            self._copy(verb, programs[first : first + MAX_COPIES])

    def _copy(self, verb: str, programs: Sequence[SupervisedProgram]) -> None:
        texts = ",".join(program.arguments[1] for program in programs)
        arguments = (verb + COPIES_SUFFIX, f"[{texts}]")
        original = SupervisedProgram(verb, arguments, module=PREPARED_START_MODULE)
        for program in programs:
            program.started_s, program.restart_at_s = time.monotonic(), math.inf
        self._pending.append(PendingCopies(self._start_process(original), programs))

    def _take_copies(self, timeout_s: float = 0.0) -> None:
        """Take the copies of processes that have ended, at most after a time."""
        for pending in tuple(self._pending):
            with suppress(subprocess.TimeoutExpired):
                pending.original.wait(timeout_s)
                pending.take()
                self._pending.remove(pending)
                if not self._pending:
                    set_subreaper(is_one=False)

    def start(
        self,
        name: str,
        arguments: Sequence[str],
        *,
        is_restarted: bool = False,
        is_essential: bool = True,
        module: str = CLI_MODULE,
        grace_s: float = TERMINATE_TIMEOUT_S,
    ) -> SupervisedProgram:
        """Start `zensim ARGUMENTS`, or another module, as a process in a new session."""
        program = SupervisedProgram(
            name, tuple(arguments), is_restarted, is_essential, module, grace_s=grace_s
        )
        program.process = self._start_process(program)
        self.programs.append(program)
        return program

    def watch(self) -> None:
        """Check the processes once, and restart those that exited, if permitted.

        Raises:
            ProgramDied: An essential process exited that is not restarted.
        """
        if self._pending:
            self._take_copies()
        for program in self.programs:
            if program.process is None:
                if time.monotonic() >= program.restart_at_s:
                    program.process = self._start_process(program)
                continue
            if (status := program.process.poll()) is None:
                continue
            close_pipes(program.process)
            program.failures += status != 0
            is_again = program.is_restarted or (program.is_restarted_if_killed and status < 0)
            is_last = not is_again or program.restarts >= MAX_RESTARTS
            if is_last and program.is_essential:
                raise ProgramDied(f"{program.name} exited with status {status}")
            program.process = None
            now_s = time.monotonic()
            delay_s = 0.0 if now_s - program.started_s > STEADY_S else RESTART_DELAY_S
            program.restart_at_s = math.inf if is_last else now_s + delay_s
            self.on_restart(program, status)
            program.restarts += not is_last

    def close(self) -> None:
        """End all processes: SIGTERM, then SIGKILL after the grace period."""
        self._take_copies(COPIES_TIMEOUT_S)
        # The server ends last, so that the others still have a network.
        last = [one for one in reversed(self.programs) if one.process is not None]
        end_processes({one.process: one.grace_s for one in last if one.process is not None})
        for one in last:
            one.failures += one.process is not None and one.process.returncode != 0
        self.programs.clear()

    def _start_process(self, program: SupervisedProgram) -> "subprocess.Popen[bytes]":
        program.started_s = time.monotonic()
        verb = program.arguments[0] if program.module == CLI_MODULE else ""
        return start_process(
            make_module_command(program.module, *program.arguments),
            stdout=subprocess.PIPE,
            stderr=self.errors,
            environment={
                PARENT_PID_VARIABLE: str(os.getpid()),
                **({LOG_FORMAT_VARIABLE: CURRENT.log_format} if CURRENT.log_format else {}),
                **hide_settings(os.environ, verb),
            },
        )
