"""The process that makes plants one by one, so that gmsh may crash or hang in it.

It says that it is ready, then reads one JSON request a line and answers with one JSON line.
It ends when its input does, or its parent: who asked is gone then.
"""

import contextlib
import gc
import importlib
import json
import os
import queue
import resource
import sys
import threading
import time
from pathlib import Path
from typing import Any

from plantsim.datasets import store
from plantsim.datasets.folder import Folder, row_of
from plantsim.datasets.recipe import Recipe
from plantsim.errors import DependencyError
from plantsim.lifetime import end_with


def make(request: dict[str, Any]) -> dict[str, Any]:
    """Make a plant and write its file; return its index row, a failure, or a halt.

    A failure is of this plant; a halt (no room, no permission, a library that is missing)
    would befall every other one too.
    """
    answer = _made(request)
    # a model and its columns refer to each other, and Python counts objects, not the
    # gigabytes in their factors: left to itself it kept ten plants
    gc.collect()
    return answer


def _made(request: dict[str, Any]) -> dict[str, Any]:
    plant, folder = request["plant"], Folder(Path(request["folder"]))
    clock = time.process_time()
    try:
        from plantsim.datasets.plant import make_plant  # noqa: PLC0415  gmsh may be missing

        made = make_plant(Recipe.from_mapping(request["recipe"]), plant)
        path = folder.plant_file(plant)
        # no parents: a machine that does not see the folder is not to make one of its own
        path.parent.mkdir(exist_ok=True)
        began = time.perf_counter()
        store.write(
            path,
            made.arrays,
            made.facts,
            lambda: {
                **made.seconds,
                "write": time.perf_counter() - began,
                "cpu": time.process_time() - clock,
            },
        )
        return {"row": row_of(path, folder.path)}
    except (OSError, DependencyError) as why:
        if isinstance(why, OSError) and why.errno is None:
            return {"failure": f"{type(why).__name__}: {why}"}
        where = getattr(why, "filename", None) or folder.path
        said = getattr(why, "strerror", None)
        return {"halt": f"{where}: {said}" if said else str(why)}
    except Exception as why:  # whatever the libraries raise is this plant's failure
        name = type(why).__name__
        return {"failure": f"{name}: {' '.join(str(why).split())[:500]}"}


def main() -> None:
    """Serve requests until the input ends; the kernels' chatter goes nowhere."""
    end_with(int(sys.argv[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    waiting: queue.SimpleQueue[str] = queue.SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            waiting.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    answer: dict[str, Any] = {"ready": True}
    with contextlib.suppress(ImportError):  # then the first plant tells what is missing
        importlib.import_module("plantsim.datasets.plant")
    gc.freeze()  # the libraries stay, and need not be looked through after each plant
    while True:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
        answer = make(json.loads(waiting.get()))


if __name__ == "__main__":
    main()
