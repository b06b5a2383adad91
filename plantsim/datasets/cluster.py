"""Dask: many plants on the processes of this machine or on a cluster. The home of Dask."""

import logging
import signal
import socket
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from plantsim.datasets.warden import end_children, plant_in_child
from plantsim.errors import DatasetError, needs

CONNECT = 15.0  # s to wait for a scheduler
PATIENCE = 60.0  # s to wait for its first worker
CLIENT: dict[str, Any] = {"set_as_default": False}  # leave the user's own client alone
GONE = "the Dask scheduler is gone. Start it again"
AHEAD = 3  # plants under way or waiting, a thread


@contextmanager
def connected(scheduler: str | None, workers: int) -> Iterator[Any]:
    """Yield a Dask client: of `workers` local processes, or of a running scheduler.

    Local processes are spawned, one thread each, and end with this one, however it ends.
    """
    dask_config, distributed = needs("dask.config", "scale"), needs("distributed", "scale")
    Client, LocalCluster = distributed.Client, distributed.LocalCluster
    config = {"distributed.worker.multiprocessing-method": "spawn"}
    with _silent("distributed"), dask_config.set(config):
        if scheduler is None:
            with _local(LocalCluster, workers) as own, Client(own, **CLIENT) as client:
                yield client
            return
        try:
            client = Client(scheduler, timeout=CONNECT, **CLIENT)
        except (OSError, ValueError, TypeError) as why:
            raise DatasetError(
                f"no Dask scheduler at {scheduler} ({why or type(why).__name__}). Give the "
                "address that `dask scheduler` prints, tcp://HOST:8786."
            ) from None
        with client:
            yield client


@contextmanager
def _deaf() -> Iterator[None]:
    """Ignore the keyboard's interrupt, so that processes begun meanwhile do so for good.

    This one is told by it alone, and ends them in order.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _local(kind: Any, workers: int) -> Any:
    """Return a cluster of spawned processes, which listens on loopback only."""
    try:
        with _deaf():
            return kind(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
    except RuntimeError as why:
        raise DatasetError(
            f"the worker processes did not start ({why}). A script that calls ps.dataset "
            'needs `if __name__ == "__main__":` before it.'
        ) from None


@contextmanager
def _silent(package: str) -> Iterator[None]:
    """Keep a package's loggers still: a killed worker is our business, and told by us."""
    known = (name for name in logging.root.manager.loggerDict)
    own = [n for n in known if n == package or n.startswith(f"{package}.")]
    levels = {name: logging.getLogger(name).level for name in own}
    for name in own:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def sees(folder: str, mark: str) -> tuple[str, bool]:
    """Return the host of this worker, and whether it sees the data set's folder."""
    return socket.gethostname(), Path(folder, mark).exists()


def check_workers(client: Any, folder: Path, mark: str) -> int:
    """Return the number of threads; DatasetError unless all workers see the folder."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise DatasetError(
            "the Dask scheduler has no workers. Start some: dask worker ADDRESS"
        ) from None
    try:
        found = client.run(sees, str(folder), mark)
    except Exception as why:  # whatever a worker without plantsim says
        raise DatasetError(
            f"a Dask worker cannot run plantsim ({type(why).__name__}: {why}). Install the "
            "same plantsim[scale] there."
        ) from None
    blind = [host for host, good in found.values() if not good]
    if blind:
        raise DatasetError(
            f"{len(blind)} of {len(found)} Dask workers (first: on {blind[0]}) do not see "
            f"{folder}. Give a folder that all machines share."
        )
    return sum(client.nthreads().values())


def make_all(
    client: Any,
    recipe: dict[str, Any],
    plants: Iterator[int],
    folder: Path,
    threads: int,
    tell: Callable[[dict[str, Any]], None],
) -> list[str]:
    """Make plants, tell each answer; return why some were lost with their workers.

    Dask keeps the queue; no more than a few a thread are handed to it ahead. Raises
    DatasetError where the scheduler is gone, or a worker says that no plant can be made.
    """
    from distributed import as_completed  # noqa: PLC0415

    run = uuid.uuid4().hex[:8]

    def submit(plant: int) -> Any:
        name = f"plant-{plant}-{run}"
        return client.submit(
            plant_in_child, recipe, plant, str(folder), key=name, pure=False
        )

    lost: list[str] = []
    first = [submit(p) for p in islice(plants, AHEAD * threads)]
    pending = as_completed(first, loop=client.loop)
    for future in pending:
        if future.status == "finished":
            try:
                answer = future.result()
            except (OSError, CancelledError):  # between its end and its fetching
                raise DatasetError(GONE) from None
            if "halt" in answer:
                raise DatasetError(f"{answer['halt']}. Make room or mend that")
            tell(answer["row"])
        elif future.status == "error":
            why = future.exception()  # of the workers that had it, not of the plant
            lost.append(" ".join(f"{type(why).__name__}: {why}".split())[:200])
        else:
            raise DatasetError(GONE)
        future.release()
        pending.update([submit(p) for p in islice(plants, 1)])
    return lost


def release(client: Any) -> None:
    """End the processes that the workers of a cluster made plants in."""
    client.run(end_children)
