"""LOAM: edges and planes of scan lines, registered to a map of them; led by the IMU, or by the scan before."""
