"""When an incremental smoother relinearises, how far it carries steps, and how much it does in one update."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_range

__all__ = ["CONSTRAINT_SIGMA", "ISAM2Settings", "OutlierRejection"]

# What a hard constraint weighs in the tree [rad, m]: far below any sensor's sigma, and its information far enough from
# 10^16 times that of the weakest factor for double precision.
CONSTRAINT_SIGMA = 1e-5


_MAX_COUNT = 1e12  # variables of any tree, and well within what native counters hold


@dataclass(frozen=True, slots=True, kw_only=True)
class ISAM2Settings:
    """When an update relinearises, and how far steps are carried down the tree.

    Parameters
    ----------
    relinearize_threshold : float
        A variable is relinearised where an element of its step is longer [rad, m].
    relinearize_skip : int
        Relinearise only in every n-th update, n being this.
    wildfire : float
        Steps that change by no more than this are not carried on to what lies below [rad, m].
    max_steps : int
        Variables whose step is computed in one update. Beyond, whole branches of the tree are deferred: later updates
        compute their steps, and a variable that is read has its step computed first. A loop over a drive of a million
        poses moves all of them, and no update waits for that. Without limit where a threshold is zero, where
        convergence is asked for, and in an update without factors.
    max_relinearized : int
        Variables that are relinearised in one update; the others wait. Later updates take up a 64th of this and of
        `max_steps` each, gathered to quarters. Without limit where `max_steps` is.

    Raises
    ------
    ConfigError
        A value is out of its range.
    """

    relinearize_threshold: float = 0.1
    relinearize_skip: int = 1
    wildfire: float = 1e-3
    max_steps: int = 10_000
    max_relinearized: int = 10_000

    def __post_init__(self) -> None:
        check_range(self, "relinearize_threshold", "wildfire", low=0.0)
        check_range(self, "relinearize_skip", "max_steps", "max_relinearized", low=1, high=_MAX_COUNT)


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlierRejection:
    """How an incremental smoother tells false loops, and lets them go.

    Parameters
    ----------
    probability : float
        That a true factor is nearer to what the others say than the threshold: the chi-square quantile of its rows, of
        its squared innovation.
    scale_margin : float
        Where the residuals of accepted factors are much shorter than their noise says, the threshold shrinks to as many
        times their own scale (as a standard deviation); infinite: never. It never grows.
    step : float
        By which the convexity of the Geman-McClure surrogate falls a round, where loops are decided anew.
    max_rounds : int
        Rounds of either kind in one update.

    Raises
    ------
    ConfigError
        A value is out of its range.
    """

    probability: float = 0.999
    scale_margin: float = 4.0
    step: float = 4.0
    max_rounds: int = 20

    def __post_init__(self) -> None:
        check_range(self, "probability", above=0.0, below=1.0)
        check_range(self, "scale_margin", above=0.0)
        check_range(self, "step", above=1.0)
        check_range(self, "max_rounds", low=1)
