"""LiDAR-inertial mapping: a recording goes in, a trajectory and a de-skewed map come out."""
