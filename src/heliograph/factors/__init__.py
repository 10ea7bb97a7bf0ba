"""Sensor factors: what an IMU and a satellite receiver measure, as factors of the graph."""
