"""Heliograph: imu."""
