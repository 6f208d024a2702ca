"""Tasks on this machine: one after the other in this process, or by several that take the next when one is done."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

from page_runtime.validation.comparison import Comparison
from page_runtime.validation.work import Task, do

# Of a task whose process died; the second time it is the task's fault, not the machine's.
ATTEMPTS = 3
Done = tuple[Task, tuple[Comparison, ...]]


class WorkerLost(RuntimeError):
    """Processes that work on a task end again and again; the message names it."""


def one_after_the_other(tasks: Sequence[Task], on_frame: Callable[[], None]) -> Iterator[Done]:
    """Every task with its result, in order, on_frame after each frame."""
    for task in tasks:
        yield task, do(task, on_frame)


def by_processes(tasks: Sequence[Task], processes: int) -> Iterator[Done]:
    """Every task with its result, as they come. A task whose process was killed is done again by another.

    Errors of a task are raised here. WorkerLost when processes die ATTEMPTS times over the same tasks.
    """
    waiting = list(tasks)
    for _ in range(ATTEMPTS):
        finished: set[Task] = set()
        try:
            for task, found in _one_pool(waiting, processes):
                finished.add(task)
                yield task, found
        except BrokenProcessPool:
            waiting = [task for task in waiting if task not in finished]
            continue
        return
    first = waiting[0]
    raise WorkerLost(
        f"processes ended {ATTEMPTS} times without a result, the last time with {len(waiting)} pieces of work left, "
        f"the first of {first.recording}, frames {first.first} to {first.last - 1}; is there memory for {processes}?"
    )


def _one_pool(tasks: Sequence[Task], processes: int) -> Iterator[Done]:
    # Fresh interpreters: a fork of a process that runs onnxruntime's threads may hang.
    with ProcessPoolExecutor(
        processes,
        mp_context=multiprocessing.get_context("spawn"),
        # Ctrl-C goes to the whole group; this process alone answers it, and lets them finish what they are at.
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    ) as pool:
        running: dict[Future[tuple[Comparison, ...]], Task] = {pool.submit(do, task): task for task in tasks}
        try:
            while running:
                ended, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in ended:
                    task = running.pop(future)
                    yield task, future.result()
        finally:
            for future in running:
                future.cancel()
