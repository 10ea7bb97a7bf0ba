"""One adapter a system: the command that runs it with its own defaults, and how its result is read."""

from benchmarks.rivals import genz_icp, heliograph_run, kiss_icp, rko_lio
from benchmarks.rivals.adapter import Adapter, Job

__all__ = ["ADAPTERS", "Adapter", "Job"]

ADAPTERS: dict[str, Adapter] = {
    a.name: a for a in (heliograph_run.ADAPTER, rko_lio.ADAPTER, kiss_icp.ADAPTER, genz_icp.ADAPTER)
}
