"""Warden: asks a child process for plants, and ends it where it takes too long."""

import json
import os
import select
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from plantsim.datasets.draw import drawn, split_of
from plantsim.datasets.folder import Folder, Row
from plantsim.datasets.recipe import Recipe

# one plant, one core: threads of BLAS gain nothing here and take from the other plants
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
START = 300.0  # s that the libraries may take to load
TRIES = 2  # of a plant whose process was killed or crashed, before that is its failure


class Ended(Exception):
    """The child is gone without an answer: what happened, in words."""


class NotStarted(Exception):
    """A child could not be started, which is no plant's fault: why, in words."""


class Child:
    """One child process, started at need and again after it was ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._said: Any = None

    def ask(self, request: dict[str, Any], limit: float) -> dict[str, Any]:
        """Return the child's answer.

        Raises TimeoutError after `limit` seconds, Ended where it crashed, and NotStarted;
        it is gone then.
        """
        answered = False
        try:
            process = self._running()
            assert process.stdin is not None
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            answer = _line(process, limit)
            answered = True
            return answer
        except BrokenPipeError:
            raise Ended(self._last_words()) from None
        finally:
            if not answered:
                self.end()

    def end(self) -> None:
        """Kill the child, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    try:
                        pipe.close()
                    except BrokenPipeError:
                        pass
            self._said.close()
            self._process = None

    def _running(self) -> "subprocess.Popen[bytes]":
        if self._process is not None and self._process.poll() is not None:
            self.end()
        if self._process is None:
            self._said = tempfile.TemporaryFile()
            self._process = subprocess.Popen(
                [sys.executable, "-m", "plantsim.datasets.child", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                env={**os.environ, **dict.fromkeys(THREADS, "1")},
                start_new_session=True,  # an interrupt at the keyboard is not for it
            )
            try:
                _line(self._process, START)
            except BrokenPipeError:
                raise NotStarted(self._last_words()) from None
            except TimeoutError:
                raise NotStarted(f"no process was ready in {START:g} s") from None
        return self._process

    def _last_words(self) -> str:
        assert self._process is not None
        code = self._process.wait()
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").strip().splitlines()
        words = f": {lines[-1][:200]}" if lines else ""
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"the process that made it ended by {how}{words}"


def _line(process: "subprocess.Popen[bytes]", limit: float) -> dict[str, Any]:
    """Return the next JSON line; TimeoutError, or BrokenPipeError at the end."""
    assert process.stdout is not None
    answer, until = b"", time.monotonic() + limit
    while not answer.endswith(b"\n"):
        left = until - time.monotonic()
        ready, _, _ = select.select([process.stdout], [], [], max(left, 0))
        if not ready:
            raise TimeoutError
        part = os.read(process.stdout.fileno(), 65536)
        if not part:
            raise BrokenPipeError
        answer += part
    return json.loads(answer)


_children: dict[int, Child] = {}  # by thread


def plant_in_child(recipe: dict[str, Any], plant: int, folder: str) -> dict[str, Any]:
    """Make one plant in this thread's child process; return its row, or a halt.

    A plant that could not be made has its reason on disk when this returns.
    """
    child = _children.setdefault(threading.get_ident(), Child())
    request = {"recipe": recipe, "plant": plant, "folder": folder}
    limit, answer = float(recipe["timeout"]), {}
    for attempt in range(TRIES):
        try:
            answer = child.ask(request, limit)
        except TimeoutError:
            answer = {
                "kind": "timeout",
                "failure": f"not done after {limit:g} s, and ended. Give it more: timeout",
            }
        except Ended as why:
            answer = {"kind": "crash", "failure": f"{why} ({attempt + 1} times)"}
            continue
        break
    if "failure" not in answer:
        return answer
    made = Recipe.from_mapping(recipe)
    row: Row = {
        "plant": plant,
        "status": "failed",
        "split": split_of(made, plant),
        "species": drawn(made, plant).kind.name,
        "kind": answer.get("kind", "error"),
        "reason": answer["failure"],
        "bytes": 0,
    }
    try:
        Folder(Path(folder)).write_failure(plant, row)
    except OSError as why:
        return {"halt": f"{why.filename or folder}: {why.strerror or why}"}
    return {"row": row}


def end_children() -> None:
    """End the child processes of this worker."""
    for child in list(_children.values()):
        child.end()
    _children.clear()
