"""Turns at a few threads: questions are answered in the order in which they come, or refused as busy."""

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

from ogm_core.errors import OgmError
from ogm_services.replies.answer import Busy, Unavailable

TURN_PATIENCE = 5.0
"""So long a question waits for its turn, s."""
MAX_QUESTIONS = 64
"""So many questions may wait; more are refused at once."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class _Question:
    answer: Callable[[], Any]
    outcome: "Future[Any]"
    until: float


class Turns:
    """Threads for one share of the questions, so that those of another share never wait for them.

    Any thread asks; nobody is made to wait. Closed once.
    """

    def __init__(self, share: str, threads: int, waiting: int = MAX_QUESTIONS) -> None:
        """`share` names the questions in threads and errors; of them `waiting` may wait for the threads."""
        self._share = share
        self._room = waiting
        self._lock = threading.Lock()
        self._waiting: deque[_Question] = deque()
        self._working = 0
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads, f"ogm-{share}")
        self._closed = threading.Event()
        # A daemon: where nobody closes, it keeps no process from ending.
        self._clock = threading.Thread(target=self._refuse_the_late, name=f"ogm-{share}-clock", daemon=True)
        self._clock.start()

    def take(self, answer: Callable[[], _T]) -> "Future[_T]":
        """What `answer` returns or raises, once a thread has come to it.

        The future raises Busy if too many wait already, or after TURN_PATIENCE; Unavailable if it is closed.
        """
        outcome: Future[_T] = Future()
        with self._lock:
            refused = self._refusal()
            if refused is None:
                self._waiting.append(_Question(answer, outcome, time.monotonic() + TURN_PATIENCE))
                self._pool.submit(self._answer_next)
        if refused is not None:
            outcome.set_exception(refused)
        return outcome

    def close(self) -> None:
        """Refuse who waits, and finish what is in hand."""
        with self._lock:
            self._closed.set()
            waiting, self._waiting = self._waiting, deque()
        for question in waiting:
            _refuse(question, self._stopping())
        self._pool.shutdown()
        self._clock.join()

    def _refusal(self) -> OgmError | None:
        if self._closed.is_set():
            return self._stopping()
        # Those that a thread is free for wait for an instant only.
        if len(self._waiting) - (self._threads - self._working) >= self._room:
            return Busy(f"{self._room} others wait for {self._share} already: try again later")
        return None

    def _stopping(self) -> OgmError:
        return Unavailable("the service is stopping")

    def _answer_next(self) -> None:
        with self._lock:
            if not self._waiting:  # it was refused meanwhile
                return
            question = self._waiting.popleft()
            self._working += 1
        try:
            if question.outcome.set_running_or_notify_cancel():
                _settle(question)
        finally:
            with self._lock:
                self._working -= 1

    def _refuse_the_late(self) -> None:
        while not self._closed.wait(self._next_look()):
            while (question := self._late()) is not None:
                why = f"{self._share}: no turn came within {TURN_PATIENCE:g} s: try again later"
                _refuse(question, Busy(why))

    def _next_look(self) -> float:
        with self._lock:
            soonest = self._waiting[0].until - time.monotonic() if self._waiting else TURN_PATIENCE
        return min(max(soonest, 0.0), TURN_PATIENCE / 10)

    def _late(self) -> _Question | None:
        with self._lock:
            late = self._waiting and self._waiting[0].until <= time.monotonic()
            return self._waiting.popleft() if late else None


def _settle(question: _Question) -> None:
    try:
        value = question.answer()
    except BaseException as error:  # noqa: BLE001 (it is who has asked whom it concerns)
        question.outcome.set_exception(error)
    else:
        question.outcome.set_result(value)


def _refuse(question: _Question, error: OgmError) -> None:
    if question.outcome.set_running_or_notify_cancel():
        question.outcome.set_exception(error)
