# SPDX-License-Identifier: GPL-3.0-or-later
"""Worker pools that run jobs: threads of this process, each with a child process, or the workers of a Dask cluster."""

# pyright: reportMissingImports=false
# (the package distributed is optional)

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from ..errors import InputError, IrgsppError
from ..machine.thread_pool import cores
from .job_runner import CANCEL, run_job
from .job_state import JobFolder, State
from .jobs import Job

RESUBMISSIONS = 2  # of a job that Dask gave up because one worker after the other died while running it
CONNECT_SECONDS = 20


class JobHandle(Protocol):
    """Handle of a job that was submitted to a pool."""

    def done(self) -> bool:
        """Return True once the job has ended, in whatever state."""
        ...

    def result(self) -> State:
        """Return the final state."""
        ...

    def withdraw(self) -> None:
        """Cancel the job unless a worker has begun it."""
        ...


class Pool(Protocol):
    """Pool of workers that run jobs."""

    def submit(self, job: Job) -> JobHandle:
        """Queue a job."""
        ...


class LocalHandle:
    """Handle of a job on this machine."""

    def __init__(self, future: Future[State]) -> None:
        self._future = future

    def done(self) -> bool:
        """Return True once the job has ended, in whatever state."""
        return self._future.done()

    def withdraw(self) -> None:
        """Cancel the job unless a worker has begun it."""
        self._future.cancel()

    def result(self) -> State:
        """Return the final state; an exception of the runner is a failure."""
        if self._future.cancelled():
            return State("cancelled")
        error = self._future.exception()
        return self._future.result() if error is None else State("failed", f"{type(error).__name__}: {' '.join(str(error).split())}")


class LocalPool:
    """Threads on this machine that run several jobs at the same time, each with an equal part of the cores.

    Args:
        batch: folder of the batch.
        at_once: number of jobs at the same time.
    """

    def __init__(self, batch: Path, at_once: int) -> None:
        self._executor = ThreadPoolExecutor(at_once)
        self._work = partial(run_job, batch=batch, threads=max(1, cores() // at_once) if at_once > 1 else None)

    def submit(self, job: Job) -> LocalHandle:
        """Queue a job."""
        return LocalHandle(self._executor.submit(self._work, job))

    def close(self) -> None:
        """Wait for all jobs."""
        self._executor.shutdown()


class DaskHandle:
    """Handle of a job on a cluster; submits it again where its workers died more often than Dask itself retries.

    Args:
        client: of the cluster.
        job: to run.
        batch: folder of the batch.
    """

    def __init__(self, client: Any, job: Job, batch: Path) -> None:
        self._client, self._job, self._batch, self._resubmissions = client, job, batch, 0
        self._submit()

    def _submit(self) -> None:
        self._future = self._client.submit(_on_worker, self._job, self._batch, key=f"{self._job.name}-{os.urandom(4).hex()}", pure=False)

    def done(self) -> bool:
        """Return True once the job has ended, in whatever state; submits it again where Dask gave it up."""
        if not self._future.done():
            return False
        if (
            self._future.status == "error"
            and type(self._future.exception()).__name__ == "KilledWorker"
            and self._resubmissions < RESUBMISSIONS
        ):
            self._resubmissions += 1
            self._submit()
            return False
        return True

    def withdraw(self) -> None:
        """Cancel the job unless a worker has begun it."""
        if JobFolder(self._batch / self._job.name).read().state == "waiting":
            self._future.cancel()

    def result(self) -> State:
        """Return the final state; an error of the cluster is a failure."""
        if self._future.status == "cancelled" and (self._batch / CANCEL).exists():
            return State("cancelled")
        if self._future.status == "finished":
            return self._future.result()
        error = self._future.exception() if self._future.status == "error" else None
        return State("failed", " ".join(f"on the cluster: {error or self._future.status}".split()))


class DaskPool:
    """Workers of a Dask cluster, on machines that see the same folders.

    Args:
        client: of the cluster.
        batch: folder of the batch.
    """

    def __init__(self, client: Any, batch: Path) -> None:
        self._client, self._batch = client, batch

    def submit(self, job: Job) -> DaskHandle:
        """Queue a job."""
        return DaskHandle(self._client, job, self._batch)


@contextmanager
def open_pool(batch: Path, at_once: int, address: str | None) -> Iterator[Pool]:
    """Open a pool of workers, and wait for those of this machine at the end.

    Args:
        batch: folder of the batch.
        at_once: number of jobs at the same time on this machine.
        address: of a Dask scheduler; None: this machine.

    Raises:
        InputError: when no scheduler answers at the address.
    """
    if address is None:
        local = LocalPool(batch, at_once)
        try:
            yield local
        finally:
            local.close()
        return
    with _client(address) as client:
        yield DaskPool(client, batch)


def _client(address: str) -> Any:
    """Connect to a Dask scheduler."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask", "needs the package distributed", "run: pip install 'irgspp[farm]'") from None
    try:
        return Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--dask {address}", f"no scheduler answers there ({' '.join(str(error).split())[:120]})", "start one") from error


def _on_worker(job: Job, batch: Path) -> State:
    """Run a job in a worker of the cluster; several worker threads of one process share the machine's cores."""
    from distributed import get_worker

    if not batch.is_dir():
        raise IrgsppError(f"{batch}: does not exist on {get_worker().address}; mount the same folders on all machines")
    threads = get_worker().state.nthreads
    return run_job(job, batch, max(1, cores() // threads) if threads > 1 else None)
