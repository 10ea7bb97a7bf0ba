"""Settings of the solvers."""

from __future__ import annotations

from dataclasses import dataclass

from heliograph.config_checks import check_choice, check_range

__all__ = ["ORDERINGS", "SolverSettings"]

ORDERINGS = {"auto": 0, "amd": 1, "nested_dissection": 2, "natural": 3}  # as the native side numbers them


@dataclass(frozen=True, slots=True, kw_only=True)
class SolverSettings:
    """When to stop, and how steps are held back.

    Parameters
    ----------
    max_iterations : int
        Steps tried, those that are rejected included.
    relative_decrease : float
        Converged when a full step lowers the cost by at most this share of it.
    absolute_decrease : float
        Converged when a full step lowers the cost by at most this.
    initial_damping : float
        Levenberg-Marquardt: of the diagonal, relative. Without any the first step is Gauss-Newton's,
        which long chains need: their weakest directions are a billionth of the diagonal.
    max_damping : float
        Levenberg-Marquardt: above it the solver gives up as stalled.
    damping_floor : float
        Levenberg-Marquardt: least diagonal that the damping is taken of, for variables that nothing holds.
    ordering : str
        ``auto``, ``amd``, ``nested_dissection`` or ``natural``.

    Raises
    ------
    ConfigError
        A value is out of its range.
    """

    max_iterations: int = 100
    relative_decrease: float = 1e-5
    absolute_decrease: float = 1e-12
    initial_damping: float = 0.0
    max_damping: float = 1e10
    damping_floor: float = 1e-12
    ordering: str = "auto"

    def __post_init__(self) -> None:
        check_range(self, "max_iterations", "relative_decrease", "absolute_decrease", "initial_damping", low=0.0)
        check_range(self, "max_damping", "damping_floor", above=0.0)
        check_choice(self, "ordering", *ORDERINGS)
