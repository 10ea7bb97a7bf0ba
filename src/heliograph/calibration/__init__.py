"""Heliograph: calibration."""
