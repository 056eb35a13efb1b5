"""What other threads ask the utility child through the scheduler, and wait for."""

from __future__ import annotations

import queue
import threading
from typing import TYPE_CHECKING, Any

from matiere.jobs.errors import Busy
from matiere.jobs.job import JsonDict
from matiere.jobs.utility_queue import (
    CHECK,
    COMPARE,
    DEVELOP,
    DIFFERENCE,
    DRAW,
    STABILITY,
    Question,
)

if TYPE_CHECKING:
    from matiere.jobs.utility_queue import UtilityQueue

CHECK_S = 10.0  # whoever asks the utility child something waits so long
COMPARE_S = 120.0  # and for a comparison of nights
PICTURES = 8  # that wait at a time
DRAW_S = 8.0  # and for a picture, with the wait for those before it


class Questions:
    """The part of the scheduler that answers questions; call it from other threads."""

    inbox: queue.SimpleQueue[Any]
    utility: UtilityQueue
    _examining: threading.Lock
    _comparing: threading.Lock
    _drawing: threading.BoundedSemaphore

    def check_files(self, scene: JsonDict, assets: JsonDict) -> list[JsonDict]:
        """Have the utility child read a scene's files; return the faults it finds.

        When it has no time within a few seconds the answer is empty: whatever is wrong then fails
        the job later, with the same pointer.
        """
        try:
            faults: list[JsonDict] = self._ask(CHECK, {"scene": scene, "assets": assets})["faults"]
        except TimeoutError:
            return []
        return faults

    def check_material(self, request: JsonDict) -> JsonDict:
        """Have the utility child make the stability report of a material.

        One at a time: raises Busy while another is made, and when the child has no time for it.
        The answer is that of `Question`.
        """
        if not self._examining.acquire(blocking=False):
            raise Busy("the service is checking another material")
        try:
            return self._ask(STABILITY, request)
        except TimeoutError:
            raise Busy("the service is at other work (merging films, drawing images)") from None
        finally:
            self._examining.release()

    def compare_nights(self, request: JsonDict) -> JsonDict:
        """Have the utility child compare two nights; raises Busy when it has no time for it."""
        if not self._comparing.acquire(blocking=False):
            raise Busy("the service is comparing other nights")
        try:
            return self._ask(COMPARE, request, COMPARE_S)
        except TimeoutError:
            raise Busy("the service is at other work (merging films, drawing images)") from None
        finally:
            self._comparing.release()

    def develop(self, job_id: str) -> JsonDict:
        """Have the utility child make the images of an ended cell: `files` by kind, or `faults`.

        Raises Busy when the child has no time for it.
        """
        request = self.utility.images_request(job_id, on_demand=True)
        if request is None:
            gone = {"pointer": "", "code": "not_found", "message": f"job {job_id} has no film"}
            return {"faults": [gone]}
        try:
            return self._ask(DEVELOP, request)
        except TimeoutError:
            raise Busy("the service is at other work (merging films, drawing images)") from None

    def draw(self, request: JsonDict) -> JsonDict:
        """Have the utility child draw a picture (`drawing`); raises Busy when it has no time."""
        if not self._drawing.acquire(blocking=False):
            raise Busy("the service is drawing other pictures", code="too_many_pictures")
        try:
            if request["what"] == "difference":
                return self._ask(DIFFERENCE, request)  # of films as large as they may be
            return self._ask(DRAW, request, DRAW_S)
        except TimeoutError:
            why = "the service is at other work (merging films, drawing images)"
            raise Busy(why, code="too_many_pictures") from None
        finally:
            self._drawing.release()

    def _ask(self, kind: int, request: JsonDict, patience_s: float | None = None) -> JsonDict:
        question = Question(kind, request)
        self.inbox.put(question)
        try:
            return question.answer.result(CHECK_S if patience_s is None else patience_s)
        except TimeoutError:
            question.answer.cancel()
            raise
