# SPDX-License-Identifier: GPL-3.0-or-later
"""Who works jobs off: threads of this process that each watch a child process, or the workers of a dask cluster."""

# pyright: reportMissingImports=false
# (the package distributed is an option)

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
from .job_runner import CANCEL, work_off
from .job_state import JobFolder, State
from .jobs import Job

DEATHS = 2  # how often a job is given out again that dask gave up, as one worker after the other died under it
CONNECT_SECONDS = 20


class Ticket(Protocol):
    """A job that was given to a pool: `withdraw` takes it back where nobody has begun with it."""

    def done(self) -> bool: ...

    def result(self) -> State: ...

    def withdraw(self) -> None: ...


class Pool(Protocol):
    """Takes jobs."""

    def submit(self, job: Job) -> Ticket: ...


class LocalTicket:
    """A job on this machine."""

    def __init__(self, future: Future[State]) -> None:
        self._future = future

    def done(self) -> bool:
        """True once it ended, well or badly."""
        return self._future.done()

    def withdraw(self) -> None:
        """Take it back where nobody has begun with it."""
        self._future.cancel()

    def result(self) -> State:
        """How it ended."""
        if self._future.cancelled():
            return State("cancelled")
        error = self._future.exception()
        return self._future.result() if error is None else State("failed", f"{type(error).__name__}: {' '.join(str(error).split())}")


class LocalPool:
    """So many jobs at a time on this machine, each with its share of the cores."""

    def __init__(self, batch: Path, at_once: int) -> None:
        self._executor = ThreadPoolExecutor(at_once)
        self._work = partial(work_off, batch=batch, threads=max(1, cores() // at_once) if at_once > 1 else None)

    def submit(self, job: Job) -> LocalTicket:
        """Queue a job."""
        return LocalTicket(self._executor.submit(self._work, job))

    def close(self) -> None:
        """Wait for all."""
        self._executor.shutdown()


class DaskTicket:
    """A job on a cluster: given out again where its worker died more often than dask's own patience allows."""

    def __init__(self, client: Any, job: Job, batch: Path) -> None:
        self._client, self._job, self._batch, self._deaths = client, job, batch, 0
        self._submit()

    def _submit(self) -> None:
        self._future = self._client.submit(_on_worker, self._job, self._batch, key=f"{self._job.name}-{os.urandom(4).hex()}", pure=False)

    def done(self) -> bool:
        """True once it ended, well or badly."""
        if not self._future.done():
            return False
        if self._future.status == "error" and type(self._future.exception()).__name__ == "KilledWorker" and self._deaths < DEATHS:
            self._deaths += 1
            self._submit()
            return False
        return True

    def withdraw(self) -> None:
        """Take it back where nobody has begun with it."""
        if JobFolder(self._batch / self._job.name).read().state == "waiting":
            self._future.cancel()

    def result(self) -> State:
        """How it ended."""
        if self._future.status == "cancelled" and (self._batch / CANCEL).exists():
            return State("cancelled")
        if self._future.status == "finished":
            return self._future.result()
        error = self._future.exception() if self._future.status == "error" else None
        return State("failed", " ".join(f"on the cluster: {error or self._future.status}".split()))


class DaskPool:
    """The workers of a cluster that see the same folders."""

    def __init__(self, client: Any, batch: Path) -> None:
        self._client, self._batch = client, batch

    def submit(self, job: Job) -> DaskTicket:
        """Queue a job."""
        return DaskTicket(self._client, job, self._batch)


@contextmanager
def pool_for(batch: Path, at_once: int, address: str | None) -> Iterator[Pool]:
    """This machine, or the cluster whose scheduler has that address. Raises InputError where there is none."""
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
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask", "needs the package distributed", "pip install 'irgspp[farm]'") from None
    try:
        return Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"--dask {address}", f"no scheduler answers there ({' '.join(str(error).split())[:120]})") from error


def _on_worker(job: Job, batch: Path) -> State:
    """What a worker of the cluster does; several of one machine's threads share its cores."""
    from distributed import get_worker

    if not batch.is_dir():
        raise IrgsppError(f"{batch} is not there on {get_worker().address}: all machines must see the same folders")
    threads = get_worker().state.nthreads
    return work_off(job, batch, max(1, cores() // threads) if threads > 1 else None)
