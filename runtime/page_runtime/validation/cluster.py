"""Tasks on many machines, by Dask's scheduler.

Dask and not Ray: a pure-Python package of a few megabytes that needs nothing started beside its scheduler and workers,
gives each result as it is there, and does again what a lost worker had, which is all that is asked of it here. The
workers see recordings and bundles under the same paths.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence

from page_runtime.content_hash import own_code_sha256
from page_runtime.validation.comparison import Comparison
from page_runtime.validation.processes import Done, WorkerLost
from page_runtime.validation.work import Task, do

CONNECT_TIMEOUT_S = 15


class ClusterUnavailable(OSError):
    """No scheduler answers, the extra is not installed, or a worker runs other code; the message says which."""


def do_as_here(task: Task, code_sha256: str) -> tuple[Comparison, ...]:
    """The task's result by a worker, which must run the code that the caller runs: results of two versions are not
    mixed."""
    if own_code_sha256() != code_sha256:
        raise ClusterUnavailable(
            f"--cluster: the worker on {platform.node()} runs another version of page_runtime; install the same there"
        )
    return do(task)


def by_cluster(tasks: Sequence[Task], address: str) -> Iterator[Done]:
    """Every task with its result, as they come. address: of a Dask scheduler, tcp://HOST:8786.

    A task whose worker is lost is done again by another; errors of a task are raised here, WorkerLost when it takes one
    worker after the other with it.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise ClusterUnavailable(f"--cluster: {error}; pip install 'page-edge[cluster]'") from error
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ClusterUnavailable(f"--cluster: no Dask scheduler answers at {address} ({reason})") from error
    with client:
        futures = {client.submit(do_as_here, task, own_code_sha256(), pure=False): task for task in tasks}
        for future in as_completed(list(futures)):
            task = futures.pop(future)
            try:
                found = future.result()
            except KilledWorker as error:
                raise WorkerLost(
                    f"{task.recording}, frames {task.first} to {task.last - 1}: one worker after the other was lost "
                    "over it; is there memory for as many as each machine has?"
                ) from error
            # What was fetched is no longer the workers' to keep.
            future.release()
            yield task, found
