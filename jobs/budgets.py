"""Budgets of sweeps in the scheduler thread: which cells get samples next, and when one is spent.

What counts is in the database: what is spent, how far each cell is. A restart reads it again.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from matiere.jobs.budget import Wish, ahead, in_turn
from matiere.jobs.film_work import FilmWork
from matiere.jobs.store import budgets, films
from matiere.jobs.store.budgets import OpenBudget

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler

LOOK_SHARE = 0.05  # of the time, at most, goes into ranking the cells of large sweeps
SLACK = 0.05  # of the budget, to complete a range of samples that was begun


@dataclass(eq=False)
class Shared:
    """A sweep whose cells share render seconds."""

    budget: OpenBudget
    turns: dict[int, int] = field(default_factory=dict)  # film -> place in the order
    wishes: dict[int, Wish] = field(default_factory=dict)
    due: float = 0.0  # when the cells are ranked again


class Budgets:
    """Orders the cells of sweeps with a budget; lives in the scheduler thread."""

    def __init__(self, scheduler: Scheduler) -> None:
        """Serve `scheduler`."""
        self._scheduler = scheduler
        self._open: dict[str, Shared] = {}

    # -- the queue --------------------------------------------------------------------------------
    def read_queue(self, now: float, most: int) -> list[int]:
        """Rank the cells of every sweep, end those whose budget is spent; return films to open."""
        found = self._scheduler.db.read(budgets.open_budgets)
        self._open = {b.sweep_id: self._open.get(b.sweep_id, Shared(b)) for b in found}
        wanted: list[int] = []
        for budget in found:
            shared = self._open[budget.sweep_id]
            shared.budget = budget
            if now >= shared.due:
                self._rank(shared, now)
            fitting = (name for name in shared.turns if self._may_fit(shared, name))
            first = [] if budget.closed else list(itertools.islice(fitting, most))
            if budget.closed or (not first and self._is_spent(shared)):
                self._end(shared)
            wanted += first
        self._forget(set(wanted))
        return wanted

    def due(self, now: float) -> bool:
        """Tell whether the queue is to be read, though nothing was reported."""
        return any(0.0 < shared.due <= now for shared in self._open.values())

    def _rank(self, shared: Shared, now: float) -> None:
        begin = time.monotonic()
        found = self._scheduler.db.read(budgets.wishes, shared.budget.sweep_id)
        order = in_turn(found, self._left_s(shared))
        shared.turns = {wish.film_id: place for place, wish in enumerate(order)}
        shared.wishes = {wish.film_id: wish for wish in order}
        for film in self._scheduler.films.values():
            if film.id in shared.wishes:
                film.ahead = ahead(shared.wishes[film.id])
        shared.due = now + (time.monotonic() - begin) / LOOK_SHARE

    def _forget(self, wanted: set[int]) -> None:
        """Close films that others come before: all that is known of them is stored."""
        s = self._scheduler
        for film in list(s.films.values()):
            idle = not self._at_work(film) and not film.late
            if idle and film.id not in wanted and self._of(film):
                del s.films[film.id]

    # -- handing out ------------------------------------------------------------------------------
    def turn(self, film: FilmWork) -> int:
        """Return the place of a film among the cells that share its budget, 0 if it has none."""
        return min((b.turns.get(film.id, len(b.turns)) for b in self._of(film)), default=0)

    def admits(self, film: FilmWork) -> bool:
        """Tell whether the next range of samples of a film fits what is left."""
        shared = self._of(film)
        return not shared or any(self._fits(one, film) for one in shared)

    def concern(self, film: FilmWork | None) -> bool:
        """Tell whether a report of a film changes what a budget has left, or the order."""
        return film is not None and bool(self._open) and bool(self._of(film, alone=False))

    def first_samples(self, film: FilmWork, most: float) -> float:
        """Return how many samples a claim may have before anything was measured."""
        return 0.0 if self._of(film) else most  # one chunk

    def claim_s(self, film: FilmWork, most: float) -> float:
        """Return how long a claim may be, given the longest."""
        for shared in self._of(film):
            most = min(most, max(0.1 * shared.budget.seconds, 0.05), max(self._left_s(shared), 0.0))
        return most

    def _of(self, film: FilmWork, alone: bool = True) -> list[Shared]:
        """Return the budgets that a film is rendered on; none if a job without one wants it too."""
        found = [self._open[j.sweep_id] for j in film.jobs if j.sweep_id in self._open]
        return [] if alone and len(found) < len(film.jobs) else found

    def _fits(self, shared: Shared, film: FilmWork) -> bool:
        left = self._left_s(shared)
        if shared.budget.closed or left <= 0.0:
            return False
        if not self._sample_s(film):  # one chunk tells what a sample costs
            return not any(shared in self._of(f, alone=False) for f, _ in self._given())
        samples, begun = film.next_range()
        slack = SLACK * shared.budget.seconds if begun else 0.0
        return samples * self._sample_s(film) <= left + slack

    def _sample_s(self, film: FilmWork | Wish) -> float:
        """Return the seconds of a sample as the budget counts them; 0 if it is not known."""
        if film.pixel_samples:
            return film.seconds / film.pixel_samples
        s = self._scheduler
        rate = s.rates.get(film.geometry_key)
        return 1.0 / (rate * s.hands) if rate else 0.0

    def _left_s(self, shared: Shared) -> float:
        """Return the seconds that are neither spent nor given out."""
        mine = [(f, n) for f, n in self._given() if shared in self._of(f, alone=False)]
        given = sum(samples * self._sample_s(film) for film, samples in mine)
        return shared.budget.seconds - shared.budget.spent_s - given

    def _given(self) -> list[tuple[FilmWork, int]]:
        """Return the films that children hold, each with how many samples of it."""
        s = self._scheduler
        claims = [h for slot in s.slots if slot.child for h in slot.child.inflight.values()]
        return [(s.films[h.film_id], h.samples) for h in claims if h.film_id in s.films]

    # -- the end ----------------------------------------------------------------------------------
    def _at_work(self, film: FilmWork) -> bool:
        s = self._scheduler
        held = (h for slot in s.slots if slot.child for h in slot.child.inflight.values())
        busy = film.merging or any(h.film_id == film.id for h in held)
        return busy or film.ready_chunks() > film.prefix_chunks

    def _is_spent(self, shared: Shared) -> bool:
        """Tell whether nothing more fits what is left, and all that was rendered is merged."""
        mine = [f for f in self._scheduler.films.values() if shared in self._of(f, alone=False)]
        return bool(shared.wishes) and not any(map(self._at_work, mine))

    def _may_fit(self, shared: Shared, name: int) -> bool:
        """Tell whether the next range of a film, open or not, fits what is left."""
        if (film := self._scheduler.films.get(name)) is not None and film.jobs:
            return self._fits(shared, film)
        wish, left = shared.wishes[name], self._left_s(shared)
        plan = self._scheduler.work.plan(wish.width, wish.height, wish.replicates)
        samples = wish.width * wish.height * (plan.round_up(wish.spp + 1) - wish.spp)
        return left > 0.0 and bool(samples * self._sample_s(wish) <= left)

    def _end(self, shared: Shared) -> None:
        s, sweep_id = self._scheduler, shared.budget.sweep_id
        if not shared.budget.closed:
            s.db.write(budgets.close, sweep_id)
        ended, late = s.db.write(budgets.end_cells, sweep_id)
        s.health.counters["cells_unfinished"] += ended
        for job_id, film_id in late:
            if film_id not in s.films:
                row = s.db.read(films.load_film, film_id)
                s.films[film_id] = FilmWork(row, s.work, time.monotonic())
            if job_id not in s.films[film_id].late:
                s.films[film_id].late[job_id] = budgets.REASON
                s.health.counters["cells_unfinished"] += 1
        if ended:
            shared.due = 0.0
            s.wake()
            s.utility.sweeps_may_have_ended()
