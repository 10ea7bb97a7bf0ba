"""Heliograph: io."""
