"""What becomes of the results: the sink protocol, the run's summary, and the folder that a run leaves behind."""

from heliograph.output.sink import Sink
from heliograph.output.summary import RunSummary, judge

__all__ = ["RunSummary", "Sink", "judge"]
