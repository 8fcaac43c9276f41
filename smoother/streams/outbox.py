"""Work that nobody waits for: done in a thread of its own, a thing at a time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from queue import Full, Queue
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Outbox(Generic[Item]):
    """Does a job with each thing that it is given; a slow disk or terminal delays no answer."""

    def __init__(self, job: Callable[[Item], None], most: int, name: str) -> None:
        self._job = job
        self._waiting: Queue[Item] = Queue(most)
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def put(self, item: Item, seconds: float = 0.0) -> bool:
        """Give it a thing; False where there was no room for it within some time."""
        try:
            self._waiting.put(item, seconds > 0.0, seconds)
        except Full:
            return False
        return True

    def drain(self, seconds: float) -> bool:
        """Wait, no longer than some time; whether everything is done."""
        until_s = time.monotonic() + seconds
        while self._waiting.unfinished_tasks and time.monotonic() < until_s:
            time.sleep(0.01)
        return not self._waiting.unfinished_tasks

    def _work(self) -> None:
        while True:
            self._job(self._waiting.get())
            self._waiting.task_done()
