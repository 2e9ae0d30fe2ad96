"""What an identification found."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sysid.arrays import FloatArray
from uqharness.replay import Segment, Speed
from uqharness.text_tables import Tabled

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Identification(Tabled):
    """What was estimated, how, and how well it fits.

    names, initial, theta, std, std_crb, status, reason  over the parameters asked for (JSBSim properties)
    cov (k, k)        of the identified ones, in the order of ``identified``
    nuisance          biases and start states: name -> (value, std)
    outputs, measured, modelled  channels and their [(n, m)] arrays, one a segment; modelled includes biases
    residual          measured minus model of the method used (innovations for filter error), one a segment
    method            "output error" | "filter error"; simulations: replays of all segments, seconds: wall time they took
    """

    aircraft: str
    names: tuple[str, ...]
    initial: FloatArray
    theta: FloatArray
    std: FloatArray
    std_crb: FloatArray
    status: Mapping[str, str]
    reason: Mapping[str, str]
    cov: FloatArray
    nuisance: Mapping[str, tuple[float, float]]
    outputs: tuple[str, ...]
    segments: tuple[Segment, ...]
    measured: list[FloatArray]
    modelled: list[FloatArray]
    residual: list[FloatArray]
    whiteness: FloatArray
    noise: Mapping[str, float]
    method: str
    converged: bool
    warnings: tuple[str, ...]
    notes: tuple[str, ...]
    simulations: int
    seconds: float
    speed: Speed | None = None

    def __repr__(self) -> str:
        return f"Identification({self.aircraft!r}, {len(self.identified)} of {len(self.names)} identified by {self.method})"

    def _facts(self) -> Mapping[str, object]:
        return {"method": self.method, "converged": "yes" if self.converged else "no"}

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the parameters that the data determined."""
        return tuple(n for n in self.names if self.status[n] == "identified")

    def to_dataframe(self) -> pd.DataFrame:
        """The table of parameters: one row a property, with what it began at, estimate, standard error, bound and status."""
        import pandas as pd

        columns = {
            "initial": self.initial,
            "estimate": self.theta,
            "std": self.std,
            "std_crb": self.std_crb,
        }
        told = {
            "status": [self.status[n] for n in self.names],
            "reason": [self.reason[n] for n in self.names],
        }
        return pd.DataFrame({**columns, **told}, index=pd.Index(self.names, name="parameter"))


def by_channel(sentences: Sequence[str], outputs: Sequence[str]) -> list[str]:
    """Sentences that speak of outputs by number, by the channels' names."""
    return [
        re.sub(r"\boutput (\d+)", lambda found: outputs[int(found[1])], text) for text in sentences
    ]
