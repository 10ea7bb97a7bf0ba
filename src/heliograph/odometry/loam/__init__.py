"""LOAM: edges and planes of scan lines, registered to a map of them and led by the IMU."""
