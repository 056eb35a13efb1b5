"""How two nights are compared. (Apart from the comparison, which brings NumPy into the process.)"""

from __future__ import annotations

from dataclasses import dataclass

from matiere.errors import MatiereError

METHODS = ("holm", "bh", "by")
NO_CHANGE, CHANGED, INCOMPLETE = 0, 1, 3  # exit codes; 2 is wrong use
MAX_LISTED = 1000


@dataclass(frozen=True)
class Options:
    """The level of a comparison, how it is kept for many tests, and how much is described."""

    significance: float = 0.05
    method: str = "holm"
    power: float = 0.8  # of the smallest detectable change
    listed: int = 100  # changes and cells of other kinds that the report describes

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        if not 0.0 < self.significance < 0.5:
            raise MatiereError("significance must lie between 0 and 0.5", pointer="/significance")
        if not 0.5 <= self.power < 1.0:
            raise MatiereError("power must lie between 0.5 and 1", pointer="/power")
        if self.method not in METHODS:
            raise MatiereError(f"method is one of {', '.join(METHODS)}", pointer="/method")
        if not 0 <= self.listed <= MAX_LISTED:
            raise MatiereError(f"listed must lie between 0 and {MAX_LISTED}", pointer="/listed")
