"""GenZ-ICP: LiDAR only, planar and non-planar residuals; its command line and files are KISS-ICP's."""

from __future__ import annotations

from benchmarks.rivals.adapter import Adapter
from benchmarks.rivals.kiss_icp import command_of, trajectory_in

ADAPTER = Adapter(
    name="genz-icp",
    package="genz-icp",
    sensors="LiDAR",
    body="lidar",
    command=lambda job: command_of("genz_icp_pipeline", job),
    environment=lambda job: {"genz_icp_out_dir": str(job.out)},
    trajectory=trajectory_in,
)
