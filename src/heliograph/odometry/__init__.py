"""Heliograph: odometry."""
