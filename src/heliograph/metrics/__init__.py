"""Heliograph: metrics."""
