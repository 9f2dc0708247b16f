"""Processes as `subprocess` starts them, forked off one in which all is loaded: each would import for a second."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import subprocess
import sys
import threading
from multiprocessing.connection import Connection

from masking.app.cli import main

LOADED = (
    *("masking.app.cli.main_program", "masking.app.workflows.operator_process", "masking.app.workflows.run"),
    *("masking.lab.plants.adapters", "masking.lab.plants.conformance", "masking.lab.plants.group"),
    *("masking.lab.plants.udp", "masking.lab.plants.serve", "masking.lab.runs.rig_run", "masking.lab.runs.self_test"),
    *("llvmlite.binding", "scipy.linalg", "sympy"),
)


class Forked:
    """A process that runs the command line, or a text of Python; it is used as one of `subprocess.Popen`.

    Args:
        arguments: of the command line, or of the text.
        code: the text; by default the command line is run.
    """

    def __init__(self, arguments, code=None):
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([*LOADED])
        (out, child_out), (err, child_err) = context.Pipe(duplex=False), context.Pipe(duplex=False)
        given = (child_out, child_err, [*map(str, arguments)], code)
        self._process = context.Process(target=_run, args=given, daemon=True)
        self._process.start()
        self.pid = self._process.pid
        self.stdout, self.stderr = (os.fdopen(os.dup(end.fileno()), encoding="utf-8") for end in (out, err))
        for end in (out, err, child_out, child_err):
            end.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stdout.close()
        self.stderr.close()
        self._process.join()

    @property
    def returncode(self):
        """Return the status with which it has ended; None while it runs."""
        return self._process.exitcode

    poll = returncode.fget

    def wait(self, timeout=None):
        """Wait for its end; return its status."""
        self._process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired("masking", timeout)
        return self.returncode

    def communicate(self, timeout=None):
        """Wait for its end; return what it has printed."""
        said = ["", ""]

        def read(i, stream):
            said[i] = stream.read()

        readers = [threading.Thread(target=read, args=part) for part in enumerate((self.stdout, self.stderr))]
        for reader in readers:
            reader.start()
        self.wait(timeout)
        for reader in readers:
            reader.join()
        return tuple(said)

    def send_signal(self, number):
        """Send it a signal, if it runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        """End it."""
        if self.poll() is None:
            self._process.kill()


def _run(out: Connection, err: Connection, arguments: list[str], code: str | None) -> None:
    """Run what was asked for as a process of its own would."""
    os.dup2(out.fileno(), 1)
    os.dup2(err.fileno(), 2)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", closefd=False, buffering=1)  # noqa: SIM115
    sys.argv = ["masking", *arguments]
    out.close()
    err.close()
    try:
        if code is None:
            sys.exit(main())
        exec(code, {"__name__": "__main__"})  # noqa: S102  (of a test)
    finally:
        atexit._run_exitfuncs()
        sys.stdout.flush()
