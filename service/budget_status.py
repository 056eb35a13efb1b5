"""The budget of a sweep as the service last described it."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict


class BudgetStatus(BaseModel):
    """Render seconds that the cells of a sweep share, and how many are spent."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seconds: float
    target_error: dict[str, Any]
    spent_s: float
    needed_s: float | None = None
    closed: bool = False

    @property
    def share(self) -> float:
        """Return how far the sweep is: by what is spent, or sooner by what is still needed."""
        shares = [self.spent_s / self.seconds]
        if self.needed_s is not None and self.spent_s + self.needed_s > 0.0:
            shares.append(self.spent_s / (self.spent_s + self.needed_s))
        return min(max(shares), 1.0)
