"""What becomes of the results: the sink protocol, the run's summary, and the folder that a run leaves behind."""

from heliograph.output.final_poses import FinalPoses
from heliograph.output.sink import Sink
from heliograph.output.submaps import Submap, read_submaps, read_voxel
from heliograph.output.summary import RunSummary, judge

__all__ = ["FinalPoses", "RunSummary", "Sink", "Submap", "judge", "read_submaps", "read_voxel"]
