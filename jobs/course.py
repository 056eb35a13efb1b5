"""In which order the chunks of a film are rendered and merged.

Jobs count chunks by their position in this order: a prefix of it is a film. A uniform film follows
its plan. An adaptive one decides as it is merged, so its course is known as far as the merged film
has decided; every merge tells the next stretch, the same after any number of kills.
"""

from __future__ import annotations

import bisect
from typing import Any

from matiere.jobs.job import JsonDict


class Course:
    """The course of a uniform film: range by range, all tiles of each."""

    def __init__(self, plan: Any) -> None:
        """Follow `plan`."""
        self.plan = plan

    @property
    def told(self) -> bool:
        """Tell whether there is anything to go by."""
        return True

    def tell(self, news: JsonDict | None) -> None:
        """Take over what a merge has decided."""

    def chunk(self, position: int) -> int:
        """Return the plan index of the chunk at a position."""
        return position

    def samples(self, position: int) -> int:
        """Return the samples of the chunk at a position."""
        c = self.plan.chunk(self.chunk(position))
        return int((c["x1"] - c["x0"]) * (c["y1"] - c["y0"]) * (c["s1"] - c["s0"]))

    def spp(self, position: int) -> int:
        """Return the samples per pixel that the chunks before a position make."""
        return int(self.plan.boundary(position // self.plan.tiles))

    def end(self, spp: int) -> int:
        """Return the position where a film has `spp` samples per pixel, as far as is known."""
        return int(self.plan.chunk_count(spp)) if spp else 0

    def whole(self, position: int) -> int:
        """Return the last position up to this one where merging may stop."""
        return position - position % int(self.plan.tiles)

    def following(self, position: int) -> int:
        """Return the first position after this one where merging may stop; it, if none is known."""
        return position + int(self.plan.tiles)

    def ends_round(self, position: int) -> bool:
        """Tell whether a film that ends at this position is one that `mt.render` would give."""
        return position % int(self.plan.tiles) == 0

    def waits(self, position: int) -> bool:
        """Tell whether only a merge of the chunks before a position tells what follows."""
        return False


class AdaptiveCourse(Course):
    """The course of an adaptive film, as far as its merged chunks have decided it."""

    def __init__(self, plan: Any, position: int, spp: int) -> None:
        """Begin where `position` chunks are merged; `tell` must follow."""
        super().__init__(plan)
        self.news: JsonDict | None = None
        self._start, self._order = position, list[int]()
        self._spps, self._ends = [spp], [position]

    @property
    def told(self) -> bool:
        """Tell whether a merge has said what comes next."""
        return self.news is not None

    def tell(self, news: JsonDict | None) -> None:
        """Take over where the order goes on, and where its rounds end."""
        if news is None:
            return
        self.news = news
        self._start, self._order = news["start"], news["order"]
        self._spps = [spp for spp, _ in news["ends"]]
        self._ends = [position for _, position in news["ends"]]

    @property
    def _known(self) -> int:
        return self._start + len(self._order)

    def chunk(self, position: int) -> int:
        """Return the plan index of the chunk at a position."""
        return self._order[position - self._start]

    def samples(self, position: int) -> int:
        """Return the samples of the chunk at a position: of one half of the replicates."""
        return super().samples(position) // 2

    def spp(self, position: int) -> int:
        """Return the samples per pixel of the last round that ends before a position."""
        return int(self._spps[max(bisect.bisect_right(self._ends, position) - 1, 0)])

    def end(self, spp: int) -> int:
        """Return the position where the round to `spp` ends, or all that is known."""
        place = bisect.bisect_left(self._spps, spp)
        return int(self._ends[place]) if place < len(self._ends) else self._known

    def whole(self, position: int) -> int:
        """Return the last end of a round, or of what is known, up to a position."""
        stops = [end for end in (*self._ends, self._known) if end <= position]
        return int(max(stops, default=self._start))

    def following(self, position: int) -> int:
        """Return the first end of a round, or of what is known, after a position."""
        stops = [end for end in (*self._ends, self._known) if end > position]
        return int(min(stops, default=position))

    def ends_round(self, position: int) -> bool:
        """Tell whether a round ends here: between rounds every tile is lifted to a higher base."""
        return position in self._ends

    def waits(self, position: int) -> bool:
        """Tell whether nothing beyond a position is decided."""
        return position >= self._known


def is_adaptive(scene: JsonDict) -> bool:
    """Tell whether a pinned scene is to be sampled adaptively."""
    return bool(scene.get("render", {}).get("adaptive"))
