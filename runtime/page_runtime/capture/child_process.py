"""A Python child process that may die of anything without harm to this one.

Camera libraries abort and crash: an exception in one of depthai's host nodes ends its process by SIGABRT. So they run
in a child, started anew (nothing of this process's state is copied, `__main__` is not run again), joined by three
descriptors:

    memory      anonymous shared memory (memfd_create; an unlinked file where there is none): it has no name, so the
                kernel frees it with the last process that has it open, whatever they die of
    messages    a pipe of pickled messages from the child
    lifeline    a pipe to the child: first the task, later its end, which asks the child to stop

A child also dies with its parent: on Linux the kernel sends SIGKILL, elsewhere the lifeline's end is seen.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import json
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NoReturn

STDERR_KEPT = 4096
_BOOTSTRAP = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from page_runtime.capture.child_process import child_main; child_main(*map(int, sys.argv[2:]))"
)
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True, eq=False, slots=True)
class ChildEnd:
    """What a task runs with, in the child. memory: descriptor of the shared memory. send: a message to the parent.
    stopping: set when the parent wants the task to end."""

    memory: int
    send: Callable[[Any], None]
    stopping: threading.Event


Task = Callable[[ChildEnd], None]


class ChildProcess:
    """A running child, seen from the parent. payload: its task, `pickled`. environment: set in the child where the
    surroundings do not say otherwise."""

    def __init__(self, payload: bytes, *, environment: Mapping[str, str] | None = None) -> None:
        with contextlib.ExitStack() as parents, contextlib.ExitStack() as childs:
            self.memory = anonymous_memory()
            parents.callback(os.close, self.memory)
            receiving, sending = os.pipe()
            parents.callback(os.close, receiving)
            childs.callback(os.close, sending)
            listening, self._lifeline = os.pipe()
            parents.callback(os.close, self._lifeline)
            childs.callback(os.close, listening)
            descriptors = self.memory, sending, listening
            self._process = subprocess.Popen(
                [sys.executable, "-c", _BOOTSTRAP, json.dumps(sys.path), *map(str, descriptors)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=descriptors,
                env={**(environment or {}), **os.environ},
                start_new_session=True,
            )
            parents.pop_all()
        self.messages = Connection(receiving, writable=False)
        self.started_s = time.monotonic()
        self._stderr = b""
        assert self._process.stderr is not None
        os.set_blocking(self._process.stderr.fileno(), False)
        with contextlib.suppress(BrokenPipeError):
            _write_all(self._lifeline, len(payload).to_bytes(8, "little") + payload)

    @property
    def pid(self) -> int:
        """The child's process id."""
        return self._process.pid

    def is_alive(self) -> bool:
        """Whether the child still runs."""
        return self._process.poll() is None

    def stderr_tail(self) -> str:
        """The end of what the child wrote to standard error so far."""
        stream = self._process.stderr
        if stream is not None and not stream.closed:
            with contextlib.suppress(BlockingIOError):
                while piece := os.read(stream.fileno(), 65536):
                    self._stderr = (self._stderr + piece)[-STDERR_KEPT:]
        return self._stderr.decode("utf-8", "replace").strip()

    def manner_of_death(self) -> str:
        """How the child ended, in words."""
        code = self._process.poll()
        if code is None:
            return "still running"
        if code < 0:
            try:
                return f"killed by {signal.Signals(-code).name}"
            except ValueError:
                return f"killed by signal {-code}"
        last = self.stderr_tail().splitlines()[-1:]
        return f"exit code {code}" + (f" ({last[0].strip()})" if last else "")

    def stop(self, *, patience_s: float = 1.0) -> None:
        """Ask the child to end, kill it if it does not within `patience_s`, and give everything back."""
        if self._lifeline >= 0:
            os.close(self._lifeline)
            self._lifeline = -1
        deadline = time.monotonic() + patience_s
        while self.is_alive() and time.monotonic() < deadline:
            # A child that waits to be read would never see that it shall end.
            self.stderr_tail()
            with contextlib.suppress(OSError, EOFError, ValueError):
                while self.messages.poll():
                    self.messages.recv_bytes()
            time.sleep(0.005)
        self.kill()
        self.stderr_tail()
        assert self._process.stderr is not None
        self._process.stderr.close()
        self.messages.close()
        if self.memory >= 0:
            os.close(self.memory)
            self.memory = -1

    def kill(self) -> None:
        """End the child at once."""
        if self.is_alive():
            self._process.kill()
        self._process.wait()


def pickled(task: Task) -> bytes:
    """The task as a child reads it; ValueError when a child could not."""
    try:
        payload = pickle.dumps(task)
    except (AttributeError, TypeError, pickle.PicklingError) as error:
        raise ValueError(
            f"ChildProcess: expected a function of a module or a partial of one, got {task!r} ({error})"
        ) from error
    if b"__main__" in payload:
        raise ValueError(
            f"ChildProcess: {task!r} is defined in the program that was started, which a child does not run again; "
            "move it into a module that can be imported"
        )
    return payload


def anonymous_memory() -> int:
    """A descriptor of shared memory without a name, empty."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("page-runtime")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _write_all(descriptor: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def child_main(memory: int, sending: int, listening: int) -> NoReturn:
    """The child's whole life: read the task, run it, leave. Ctrl-C is the parent's to handle."""
    parent = os.getppid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
    lifeline = io.FileIO(listening)
    length = int.from_bytes(lifeline.read(8), "little")
    payload = b""
    while len(payload) < length and (piece := lifeline.read(length - len(payload))):
        payload += piece
    if len(payload) < length:
        os._exit(1)
    stopping = threading.Event()

    def watch() -> None:
        while lifeline.read(1):
            pass
        stopping.set()

    threading.Thread(target=watch, daemon=True).start()
    connection = Connection(sending, readable=False)
    lock = threading.Lock()

    def send(message: Any) -> None:
        with lock:
            try:
                connection.send(message)
            except BrokenPipeError:
                stopping.set()

    pickle.loads(payload)(ChildEnd(memory, send, stopping))
    sys.stderr.flush()
    # Threads and destructors of a camera library have been known to hang or crash at exit; nothing of theirs is wanted.
    os._exit(0)
