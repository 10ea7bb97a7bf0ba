"""Heliograph: sim."""
